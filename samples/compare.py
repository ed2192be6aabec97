"""wegs and its rivals on one scene, with the same photos, limit on Gaussians, steps and renderer.
Prints a table for the README.

    python samples/compare.py samples/plaza --preset quick
    python samples/compare.py SCENE -r 2 --seeds 3 --output runs/compare

The rivals: plain 3DGS (`--preset vanilla --sh-degree 1`) and the affine exposure model (`--set appearance=exposure`),
the latter with everything else of the method. What is finished in the output folder is neither trained nor measured
again; runs there with other settings are replaced, so use a separate folder for each preset. With several seeds the
table holds means, for PSNR with the standard deviation.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from samples.measurements.begin import begin

begin()

import click

from core.system.atomic import write_json
from samples.measurements import arguments, markdown
from samples.measurements.finished import measured
from samples.measurements.seeds import METRICS, cell, folder_name, results_of, scores_of
from samples.measurements.variants import AFFINE, FULL, PLAIN, VARIANTS
from wegs_cli.main import OneLineErrors
from wegs_cli.terminal import Terminal

RIVALS = {"wegs": FULL, "affine exposure": AFFINE, "plain 3DGS": PLAIN}


@click.command(cls=OneLineErrors)
@arguments.scene
@arguments.preset
@arguments.resolution()
@arguments.seeds(1, "Runs of each method.")
@arguments.protocol("half", "full")
@arguments.output("runs/compare")
def main(scene: Path, preset_name: str, resolution: int, seeds: int, protocols: tuple[str, ...], output: Path) -> None:
    """Train and measure wegs, the affine exposure model and plain 3DGS on SCENE."""
    runs: dict[str, list[dict]] = {name: [] for name in RIVALS}
    with Terminal() as terminal:
        for seed in range(seeds):
            for name, variant in RIVALS.items():
                settings = arguments.settings_of(
                    preset_name, None, **VARIANTS[variant].changes, resolution=resolution, seed=seed
                )
                folder = output / f"{scene.resolve().name}-{folder_name(name)}-seed{seed}"
                runs[name].append(measured(scene, settings, folder, protocols, terminal))
    write_json(output / f"{scene.resolve().name}.json", runs)
    click.echo(table(runs, protocols))


def table(runs: dict[str, list[dict]], protocols: Sequence[str]) -> str:
    """Markdown: PSNR / SSIM / LPIPS against each known truth, for zero-shot and refined looks.
    runs: of each method, one entry per seed."""
    # clean_right is known by protocol `half` alone
    against = dict.fromkeys(name for protocol in protocols for name in results_of(runs["wegs"], protocol)[0]["means"])
    columns = [f"{name}: {look}" for name in against for look in ("zero-shot", "refined")]
    rows = []
    for method, group in runs.items():
        for protocol in protocols:
            results = results_of(group, protocol)
            cells = [method, protocol]
            for name in against:
                for look in ("zero_shot", "refined"):
                    scores = {metric: scores_of(results, name, look, metric) for metric in METRICS}
                    shown = " / ".join(cell(scores[metric], "{:.2f}", metric == "psnr") for metric in METRICS)
                    cells.append("-" if scores["psnr"][0] is None else shown)
            cells.append(cell([result["mask_iou"] for result in results], "{:.2f}"))
            cells.append(cell([result["training_seconds"] for result in results], "{:.0f}", False))
            cells.append(cell([one["bytes"] / 1e6 for one in group], "{:.1f}", False))
            rows.append(cells)
    return markdown.table(["method", "protocol", *columns, "mask IoU", "training s", ".ply MB"], rows)


if __name__ == "__main__":
    main()
