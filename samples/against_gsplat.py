"""Plain 3DGS by wegs beside plain 3DGS by gsplat: whether the baseline of all other comparisons is a fair one.

    wegs train SCENE --preset vanilla -o RUN
    python samples/against_gsplat.py RUN

Needs an NVIDIA GPU and gsplat. gsplat learns from the photos of RUN at the size that RUN had, from the same points,
with the same picture loss and SH degree; learning rates, density control and schedule are its own, with either of its
strategies and as many steps, then with its own 30,000. Its `default` strategy grows without a limit, `mcmc` up to that
of RUN. Figures are means over the held-out photos, protocol full, against the clean truth where that is known.
"""

import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from samples.measurements.begin import begin

begin()

import click

from core.data.load import load_collection
from core.errors import BadInput
from core.evaluation import lpips
from core.evaluation.protocols import Distance, measure
from core.looks.held_out_views import over_views
from core.looks.trained import TrainedRun
from core.pipeline.opened import open_run
from core.report import Report
from core.system.atomic import write_json
from core.system.outputs import check_file
from core.training.sized_photos import SizedPhotos
from samples.measurements import arguments, markdown, peer
from samples.measurements.peer_training import CONTROLS, STEPS, trained_by
from samples.measurements.seeds import METRICS, cell
from wegs_cli.main import OneLineErrors
from wegs_cli.terminal import Terminal


@click.command(cls=OneLineErrors)
@arguments.run
@click.option(
    "--steps",
    "lengths",
    multiple=True,
    type=arguments.AT_LEAST_ONE,
    help=f"Repeatable. Default: those of RUN, and {STEPS:,}.",
)
@click.option("--sh-degree", type=click.IntRange(0, 3), help="Of gsplat's Gaussians. Default: that of RUN.")
@arguments.json_file
def main(run_folder: Path | None, lengths: tuple[int, ...], sh_degree: int | None, file: Path | None) -> None:
    """Compare RUN (default: the newest) with gsplat."""
    trained = open_run(run_folder, Terminal())
    gsplat = usable_peer(trained)
    if file:
        check_file(file)
    settings, rows = trained.settings, []
    degree = settings.sh_degree if sh_degree is None else sh_degree
    distance = lpips.load(trained.device)
    with Terminal() as terminal:

        def add(method: str, run: TrainedRun, steps: int, seconds: float) -> None:
            rows.append(row(method, run, steps, seconds, distance, terminal))
            if file:
                write_json(file, rows)  # each time, as the next one takes minutes

        add("wegs", trained, settings.steps, trained.seconds)
        scene = load_collection(trained.collection.read_from)  # a run keeps no points
        photos = SizedPhotos(trained.collection.split("train"), trained.sizes, trained.device, report=terminal)
        peer.picture(gsplat, trained.splats, photos.cameras[0])  # compiles its kernels, which may take minutes
        for steps in lengths or sorted({settings.steps, STEPS}):
            for name, control in CONTROLS.items():
                method, start = f"gsplat, {name}", time.perf_counter()
                on_progress = partial(terminal.progress, method)
                splats = trained_by(
                    gsplat, control, scene, photos, steps, settings.max_gaussians, degree, settings.seed, on_progress
                )
                add(method, replace(trained, splats=splats, sky_count=0), steps, time.perf_counter() - start)
    click.echo(markdown.table(list(rows[0]), [list(entry.values()) for entry in rows]))


def usable_peer(trained: TrainedRun) -> ModuleType:
    """gsplat; BadInput where it cannot be used, or the run is nothing to compare with."""
    if trained.has_looks:
        raise BadInput(f"{trained.folder} has looks, which plain 3DGS has not.", "Take a run with --preset vanilla.")
    if trained.settings.transparent_is_empty:
        raise BadInput(
            f"In {trained.folder} transparent pixels are empty space, of which gsplat is told nothing.",
            "Take a run with --set transparency=unseen.",
        )
    if trained.device.type != "cuda":
        raise BadInput(
            f"{trained.folder} was trained on a CPU, or no GPU can be used here.", "gsplat needs an NVIDIA GPU."
        )
    if (found := peer.gsplat()) is None:
        raise BadInput("gsplat is not installed.", "Type: pip install gsplat")
    return found


def row(
    method: str, trained: TrainedRun, steps: int, seconds: float, distance: Distance | None, report: Report
) -> dict[str, str]:
    """A line of the table. distance: LPIPS, if its weights are there."""
    photos = trained.collection.split("test")
    views = [
        view
        for _, (view, _) in over_views(
            trained, photos, lambda view: measure(trained, view, "full", False, distance), method, report
        )
    ]
    against = "clean" if all("clean" in view.scores for view in views) else "photo"
    scores = [view.scores[against]["zero_shot"] for view in views]
    found = ([getattr(score, metric) for score in scores] for metric in METRICS)
    return {
        "method": method,
        "steps": f"{steps:,}",
        "Gaussians": f"{len(trained.splats):,}",
        "SH degree": f"{trained.splats.degree}",
        "PSNR / SSIM / LPIPS": " / ".join(cell(values, "{:.2f}", False) for values in found),
        "training s": f"{seconds:.0f}",
    }


if __name__ == "__main__":
    main()
