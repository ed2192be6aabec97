"""wegs beside its rivals on one scene, with the same photos, limit on Gaussians, steps and renderer. Prints a table for the README.

    python samples/compare.py samples/plaza --preset quick
    python samples/compare.py SCENE -r 2 --seeds 3 --output runs/compare

The rivals: plain 3DGS (`--preset vanilla --sh-degree 1`) and the affine exposure model (`--set appearance=exposure`), the latter with
everything else of the method. What is finished in the output folder is neither trained nor measured again; runs there with other settings
are replaced, so use a folder of its own for each preset. With several seeds the table holds means, for PSNR with the standard deviation.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from core.system.process import prepare

prepare()  # before torch is imported

import click

from core.config import PRESETS, preset
from core.evaluation import PROTOCOLS
from core.system.atomic import write_json
from samples.measurements.finished import measured
from samples.measurements.seeds import METRICS, cell, folder_name
from samples.measurements.variants import AFFINE, FULL, PLAIN, VARIANTS
from wegs_cli.main import OneLineErrors
from wegs_cli.terminal import Terminal

RIVALS = {"wegs": FULL, "affine exposure": AFFINE, "plain 3DGS": PLAIN}


@click.command(cls=OneLineErrors)
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--preset", "preset_name", default="quick", show_default=True, type=click.Choice(sorted(PRESETS)))
@click.option("-r", "--resolution", default=-1, show_default=True, help="As of `wegs train`.")
@click.option("-o", "--output", default=Path("runs/compare"), show_default=True, type=click.Path(path_type=Path), help="Folder of the runs.")
@click.option("--seeds", default=1, show_default=True, type=click.IntRange(min=1), help="Runs of each.")
@click.option("--protocol", "protocols", multiple=True, default=("half", "full"), show_default=True, type=click.Choice(list(PROTOCOLS)))
def main(scene: Path, preset_name: str, resolution: int, output: Path, seeds: int, protocols: tuple[str, ...]) -> None:
    """Train and measure wegs, the affine exposure model and plain 3DGS on SCENE."""
    runs: dict[str, list[dict]] = {name: [] for name in RIVALS}
    with Terminal() as terminal:
        for seed in range(seeds):
            for name, variant in RIVALS.items():
                settings = preset(preset_name).changed(**VARIANTS[variant].changes, resolution=resolution, seed=seed)
                folder = output / f"{scene.resolve().name}-{folder_name(name)}-seed{seed}"
                runs[name].append(measured(scene, settings, folder, protocols, terminal))
    write_json(output / f"{scene.resolve().name}.json", runs)
    click.echo(table(runs, protocols))


def table(runs: dict[str, list[dict]], protocols: Sequence[str]) -> str:
    """Markdown: PSNR / SSIM / LPIPS against each truth there is, for the look as it is read and refined. runs: one entry a seed."""
    against = list(runs["wegs"][0]["results"][protocols[0]]["means"])
    lines = [
        "| method | protocol | " + " | ".join(f"{name}: zero-shot | {name}: refined" for name in against)
        + " | mask IoU | training s | .ply MB |"
    ]  # fmt: skip
    lines.append("|---" * (5 + 2 * len(against)) + "|")
    for method, group in runs.items():
        for protocol in protocols:
            results = [one["results"][protocol] for one in group]
            cells = [method, protocol]
            for name in against:
                for look in ("zero_shot", "refined"):
                    scores = [result["means"].get(name, {}).get(look, {}) for result in results]
                    metrics = [cell([one.get(metric) for one in scores], "{:.2f}", metric == "psnr") for metric in METRICS]
                    cells.append(" / ".join(metrics) if scores[0] else "-")
            cells.append(cell([result.get("mask_iou") for result in results], "{:.2f}"))
            cells.append(cell([result["training_seconds"] for result in results], "{:.0f}", False))
            cells.append(cell([one["bytes"] / 1e6 for one in group], "{:.1f}", False))
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
