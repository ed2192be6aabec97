"""What each part of the method is worth: the paper's ablation (its Table IV),
and differences of wegs from the paper, switched back.

    python samples/ablation.py samples/plaza --seeds 3
    python samples/ablation.py statue_of_liberty --preset default -r 2
    python samples/ablation.py SCENE --split val.tsv --only "no mask" --only "mask by MLP"  # to choose by

Each variant (samples/measurements/variants.py) is the base preset with a few settings changed; one that changes nothing
is the full model. Runs are trained one after the other. Those finished in the output folder are not trained again, and
those that were killed are resumed; runs there with other settings are replaced, so use a separate folder for each
preset. The script prints a Markdown table for each scene and protocol, and writes the tables to SCENE.md and the
figures of every run to SCENE.csv.
"""

import csv
import io
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from samples.measurements.begin import begin

begin()

import click

from core.config import Settings
from core.errors import BadInput
from core.report import Report
from core.system.atomic import write_text
from samples.measurements import arguments, markdown
from samples.measurements.finished import measured, with_split
from samples.measurements.seeds import METRICS, cell, folder_name, results_of, scores_of
from samples.measurements.variants import FULL, PAPER_PSNR, VARIANTS
from wegs_cli.main import OneLineErrors
from wegs_cli.terminal import Terminal

HEADER = (
    *("variant", "PSNR zero-shot", "to full", "PSNR refined", "to full", "SSIM / LPIPS", "mask IoU", ".ply MB"),
    *("training s", "paper: PSNR to full", "paper: MB"),
)
GLO = "GLO has no encoder: its zero-shot look of a held-out photo is the mean embedding. "


@click.command(cls=OneLineErrors)
@arguments.scenes
@arguments.preset
@arguments.steps()
@arguments.resolution()
@arguments.seeds(1, "Runs of each variant.")
@arguments.protocol("full")
@click.option(
    "--only",
    metavar="VARIANT",
    multiple=True,
    type=click.Choice(list(VARIANTS)),
    help="To train beside the full model; repeatable.",
)
@click.option(
    "--split",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Hold out what this .tsv says instead.",
)
@arguments.output("runs/ablation")
def main(scenes, preset_name, steps, resolution, seeds, protocols, only, split, output) -> None:
    """Train and measure the full model and its variants on each of SCENES."""
    base = arguments.settings_of(preset_name, steps, resolution=resolution)
    variants = {name: VARIANTS[name].changes for name in VARIANTS if not only or name in only or name == FULL}
    names = [scene.resolve().name for scene in scenes]
    if twice := [name for name in names if names.count(name) > 1]:
        raise BadInput(
            f"Several scenes are called {twice[0]}: their results would replace each other.",
            "Give each an -o of its own.",
        )
    with Terminal() as terminal:
        for scene in scenes:
            scene = with_split(scene, split, output) if split else scene
            runs = ablate(scene, base, variants, seeds, protocols, output / scene.resolve().name, terminal)
            text = "\n\n".join(table(scene.resolve().name, protocol, runs) for protocol in protocols)
            write_text(output / f"{scene.resolve().name}.md", text + "\n")
            write_text(output / f"{scene.resolve().name}.csv", csv_of(runs))
            click.echo(text)


def ablate(
    scene: Path,
    base: Settings,
    variants: dict[str, dict[str, Any]],
    seeds: int,
    protocols: Sequence[str],
    folder: Path,
    report: Report,
) -> dict[str, list[dict]]:
    """The figures of each variant, one entry per seed.
    All variants are trained with one seed before the next, so that a first answer comes early.

    variants: changes of the settings `base`, by name. folder: of the runs.
    """
    runs: dict[str, list[dict]] = {name: [] for name in variants}
    for seed in range(seeds):
        for number, (name, changes) in enumerate(variants.items(), 1):
            full = base.changed(seed=seed)
            settings = full.changed(**changes)
            title = FULL if settings == full else name
            report.say(f"--- {scene.resolve().name}, seed {seed}: {name} ({number} of {len(variants)})")
            runs[name].append(measured(scene, settings, folder / f"{folder_name(title)}-seed{seed}", protocols, report))
    return runs


def table(scene: str, protocol: str, runs: dict[str, list[dict]]) -> str:
    """Markdown: means over the seeds, with their standard deviation where there are several."""
    of_full = results_of(runs[FULL], protocol)
    first = of_full[0]
    against = "clean" if "clean" in first["means"] else "photo"
    what = "the clean truth" if against == "clean" else "the test photos"
    seeds = "one seed" if len(of_full) == 1 else f"{len(of_full)} seeds (mean ± standard deviation)"
    how = (
        f"{scene}: protocol {protocol}, against {what}; "
        f"{first['steps']} steps, scale {first['scale']:.2f}, {seeds}, LPIPS {first['lpips']}. "
    )
    if "embedding by GLO" in runs:
        how += GLO
    how += "SSIM and LPIPS are of the refined look, or of the zero-shot one where none can be refined."
    rows = []
    for name, group in runs.items():
        results = results_of(group, protocol)
        cells = [name]
        for look in ("zero_shot", "refined"):
            own, full = (scores_of(each, against, look, "psnr") for each in (results, of_full))
            differences = [a - b for a, b in zip(own, full, strict=True) if a is not None and b is not None]
            cells += [cell(own, "{:.2f}"), "" if name == FULL else cell(differences, "{:+.2f}")]
        best = "zero_shot" if scores_of(results, against, "refined", "psnr")[0] is None else "refined"
        cells.append(
            " / ".join(cell(scores_of(results, against, best, metric), "{:.3f}", False) for metric in METRICS[1:])
        )
        cells.append(cell([result["mask_iou"] for result in results], "{:.2f}"))
        cells.append(cell([one["bytes"] / 1e6 for one in group], "{:.1f}"))
        cells.append(cell([result["training_seconds"] for result in results], "{:.0f}"))
        paper = VARIANTS[name]
        cells.append("" if paper.psnr is None or name == FULL else f"{paper.psnr - PAPER_PSNR:+.2f}")
        cells.append("" if paper.megabytes is None else f"{paper.megabytes}")
        rows.append(cells)
    return f"{how}\n\n{markdown.table(HEADER, rows)}"


def csv_of(runs: dict[str, list[dict]]) -> str:
    """A row for each run, protocol, thing compared with, and look."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("variant", "seed", "protocol", "against", "look", *METRICS, "mask_iou", "bytes", "training_seconds"))
    for name, group in runs.items():
        for one in group:
            for protocol, result in one["results"].items():
                ends = (result["mask_iou"], one["bytes"], result["training_seconds"])
                for against, by_look in result["means"].items():
                    for look, scores in by_look.items():
                        figures = (scores[metric] for metric in METRICS)
                        rows.writerow((name, result["seed"], protocol, against, look, *figures, *ends))
    return text.getvalue()


if __name__ == "__main__":
    main()
