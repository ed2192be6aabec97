"""What leaving out unneeded parts costs and saves: a run with the parts that its photos need, beside the run that it should equal.

    python samples/make_plaza.py --variant calm --output calm
    python samples/make_plaza.py --variant exposure --output exposure
    python samples/unneeded.py calm exposure samples/plaza --steps 1200

A scene without looks is compared with plain 3DGS (`--preset vanilla`), one whose photos differ in exposure alone with the full transfer
(`--appearance full`); one that needs every part is compared with nothing. Seconds are CPU seconds of the whole `train`, medians of
--repeats runs in turn; PSNR is that of the held-out photos, with looks refined on their left half.
"""

import statistics
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from core.system.process import prepare

prepare()  # before torch is imported

import click

from core import pipeline
from core.config import Settings, preset
from core.looks.trained import load_run
from core.training.on_disk import checkpoint, run_folders
from wegs_cli.main import OneLineErrors
from wegs_cli.terminal import Terminal

RIVALS = {"off": "vanilla", "exposure": "full"}
HEADER = "| scene | decided | PSNR dB | CPU-s | checkpoint + .ply MB | beside it: PSNR | CPU-s | MB | time | bytes |"


@click.command(cls=OneLineErrors)
@click.argument("scenes", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--preset", "preset_name", default="quick", show_default=True)
@click.option("--steps", default=1200, show_default=True, type=click.IntRange(min=1))
@click.option("--repeats", default=2, show_default=True, type=click.IntRange(min=1), help="Runs of each kind; seconds are their median.")
@click.option("-o", "--output", default=Path("runs/unneeded"), type=click.Path(path_type=Path))
def main(scenes: tuple[Path, ...], preset_name: str, steps: int, repeats: int, output: Path) -> None:
    """Train each of SCENES as its photos decide, and as the rival does; prints a table for the README."""
    lines = [HEADER, "|---" * HEADER.count(" |") + "|"]
    base = preset(preset_name).changed(steps=steps)
    with Terminal() as terminal:
        measure(scenes[0], base.changed(steps=50), output / "warm-up", terminal)  # kernels compile once
        for scene in scenes:
            auto = measure(scene, base, output / f"{scene.resolve().name}-auto", terminal)
            choice = auto["settings"].appearance
            cells = [scene.resolve().name, decided(auto["settings"])]
            if choice not in RIVALS:
                lines.append("| " + " | ".join([*cells, *figures(auto), *["-"] * 5]) + " |")
                continue
            # With all three given, the rival does not look at its photos first: what that takes is counted.
            looks = {"appearance": "off", "transients": "off"} if choice == "off" else {"appearance": "full"}
            changes = {name: getattr(auto["settings"], name) for name in ("transients", "sh_degree")} | looks
            kinds = {"auto": base, RIVALS[choice]: base.changed(**changes)}
            runs = {name: [] for name in kinds}
            for repeat in range(repeats):
                for name in sorted(kinds, reverse=bool(repeat % 2)):  # each as often first: machines warm up and tire
                    runs[name].append(measure(scene, kinds[name], output / f"{scene.resolve().name}-{name}", terminal))
            medians = {name: statistics.median(one["seconds"] for one in group) for name, group in runs.items()}
            auto, rival = (runs[name][0] | {"seconds": medians[name]} for name in kinds)
            ratios = [f"{auto[name] / rival[name]:.2f}" for name in ("seconds", "bytes")]
            lines.append("| " + " | ".join([*cells, *figures(auto), *figures(rival), *ratios]) + " |")
    click.echo("\n".join(lines))


def measure(scene: Path, settings: Settings, folder: Path, terminal: Terminal) -> dict:
    """One run: its settings as decided, CPU seconds, bytes, held-out PSNR."""
    start = time.process_time()
    pipeline.train(scene, settings, folder, terminal, force=True)
    seconds = time.process_time() - start
    trained = load_run(folder)
    files = [checkpoint.newest(folder), run_folders.point_cloud_path(folder, trained.step)]
    scores = pipeline.evaluate(folder, "half", refine=True).means()["photo"]
    return {
        "settings": trained.settings,
        "seconds": seconds,
        "bytes": sum(file.stat().st_size for file in files),
        "psnr": scores.get("refined", scores["zero_shot"])["psnr"],
    }


def decided(settings: Settings) -> str:
    """The three choices in one cell."""
    return f"{settings.appearance} / {settings.transients} / degree {settings.sh_degree}"


def figures(one: dict) -> list[str]:
    """PSNR, seconds and megabytes of a run as cells."""
    return [f"{one['psnr']:.2f}", f"{one['seconds']:.1f}", f"{one['bytes'] / 1e6:.2f}"]


if __name__ == "__main__":
    main()
