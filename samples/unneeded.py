"""What leaving out unneeded parts costs and saves:
a run with the parts that its photos need, beside the run that it should equal.

    python samples/make_plaza.py --variant calm --output calm
    python samples/make_plaza.py --variant exposure --output exposure
    python samples/unneeded.py calm exposure samples/plaza --steps 1200

A scene without looks is compared with plain 3DGS (`--preset vanilla`), one whose photos differ in exposure alone with
the full transfer (`--appearance full`); one that needs every part is compared with nothing. Seconds are CPU seconds of
the whole `train`, medians over --repeats, in which both kinds take turns; PSNR is that of the held-out photos, with
looks refined on their left half.
"""

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from samples.measurements.begin import begin

begin()

import click

from core import pipeline
from core.config import Settings
from core.looks.trained import load_run
from core.run import checkpoint, run_folders
from samples.measurements import arguments, markdown
from samples.measurements.seeds import cell
from wegs_cli.main import OneLineErrors
from wegs_cli.terminal import Terminal

RIVALS = {"off": "vanilla", "exposure": "full"}
HEADER = (
    "scene",
    "decided",
    "PSNR dB",
    "CPU-s",
    "checkpoint + .ply MB",
    "beside it: PSNR",
    "CPU-s",
    "MB",
    "time",
    "bytes",
)


@click.command(cls=OneLineErrors)
@arguments.scenes
@arguments.preset
@arguments.steps(1200)
@arguments.count("--repeats", 2, "Runs of each kind; seconds are their median.")
@arguments.output("runs/unneeded")
def main(scenes: tuple[Path, ...], preset_name: str, steps: int, repeats: int, output: Path) -> None:
    """Train each of SCENES as its photos decide, and as the rival does; prints a table for the README."""
    base = arguments.settings_of(preset_name, steps)
    with Terminal() as terminal:
        measure(scenes[0], base.changed(steps=50), output / "warm-up", terminal)  # kernels compile once
        rows = [cells_of(scene, base, repeats, output, terminal) for scene in scenes]
    click.echo(markdown.table(HEADER, rows))


@dataclass(frozen=True)
class Measured:
    """A run. settings: as its photos decided. seconds: of CPU time. bytes: of its checkpoint and its .ply.
    psnr: of held-out photos, dB."""

    settings: Settings
    seconds: float
    bytes: int
    psnr: float | None

    def cells(self) -> list[str]:
        """The figures as cells of the table."""
        return [cell([self.psnr], "{:.2f}"), f"{self.seconds:.1f}", f"{self.bytes / 1e6:.2f}"]


def cells_of(scene: Path, base: Settings, repeats: int, output: Path, terminal: Terminal) -> list[str]:
    """A scene's row of the table: the run that its photos decide, its rival if it has one,
    and the ratios of the two."""
    name = scene.resolve().name
    auto = measure(scene, base, output / f"{name}-auto", terminal)
    decided = auto.settings
    cells = [name, f"{decided.appearance} / {decided.transients} / degree {decided.sh_degree}"]
    if decided.appearance not in RIVALS:
        return [*cells, *auto.cells(), *["-"] * 5]
    # With all three given, the rival does not look at its photos first: what that takes is counted.
    looks = {"appearance": "off", "transients": "off"} if decided.appearance == "off" else {"appearance": "full"}
    rival_settings = base.changed(**{"transients": decided.transients, "sh_degree": decided.sh_degree} | looks)
    kinds = {"auto": base, RIVALS[decided.appearance]: rival_settings}
    runs: dict[str, list[Measured]] = {kind: [] for kind in kinds}
    for repeat in range(repeats):
        for kind in sorted(kinds, reverse=bool(repeat % 2)):  # each as often first: machines warm up and tire
            runs[kind].append(measure(scene, kinds[kind], output / f"{name}-{kind}", terminal))
    auto, rival = (replace(group[0], seconds=median(run.seconds for run in group)) for group in runs.values())
    return [
        *cells,
        *auto.cells(),
        *rival.cells(),
        f"{auto.seconds / rival.seconds:.2f}",
        f"{auto.bytes / rival.bytes:.2f}",
    ]


def measure(scene: Path, settings: Settings, folder: Path, terminal: Terminal) -> Measured:
    """Train and measure one run; a run in its folder is replaced."""
    start = time.process_time()
    pipeline.train(scene, settings, folder, terminal, force=True)
    seconds = time.process_time() - start
    trained = load_run(folder)
    files = [*checkpoint.written(folder), run_folders.point_cloud_path(folder, trained.step)]
    scores = pipeline.evaluate(folder, "half", refine=True).means()["photo"]
    psnr = scores.get("refined", scores["zero_shot"])["psnr"]
    return Measured(trained.settings, seconds, sum(file.stat().st_size for file in files), psnr)


if __name__ == "__main__":
    main()
