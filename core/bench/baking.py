"""Baking: what is lost, and saved, when SH bands and little-seen Gaussians are left out of the file.

Gaussians are left out in the order of their contribution, the largest alpha * transmittance that they reach in any
pixel of any training view (RadSplat, section 4.2), the least first; the sky stays. Errors are those of the training
views, in 8-bit steps, against the bake with everything.
"""

from collections.abc import Callable
from functools import partial

import torch
from jaxtyping import Int
from torch import Tensor

import core.export
from core.bench.differences import HALF_STEP_LINE, differences
from core.bench.figure import Figure, Panel, Point, Quantity, Spread
from core.bench.machine import made_on
from core.bench.stopwatch import timed
from core.data.collection import spread_over
from core.looks.pruning import pruner_of
from core.looks.trained import TrainedRun, bake, neutral_look
from core.rasterizer.importance import largest_contributions
from core.report import QUIET, Report
from core.scene.splats import Splats
from core.system.atomic import scratch
from core.words import counted

LIMIT_STEPS = 255 * HALF_STEP_LINE[0], HALF_STEP_LINE[1]
QUANTITIES = (
    Quantity("megabytes", "MB of .ply", "log"),
    Quantity("seconds", "s to bake and write", "log"),
    Quantity("rms_steps", "RMS error, 8-bit steps", "log", limit=LIMIT_STEPS, floor=1e-3),
    Quantity("max_steps", "max error, 8-bit steps", "log", limit=LIMIT_STEPS, floor=1e-3),
    Quantity("milliseconds", "ms a picture", "log"),
)
PANELS = (Panel("megabytes", "rms_steps"), Panel("megabytes", "max_steps"), Panel("seconds", "rms_steps"))
SHARES = (0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7)
NOTES = (
    "Errors of the training views in the neutral look, against the bake with everything.",
    (
        "Gaussians are left out in the order of their largest contribution to any pixel of any "
        "training view; the sky stays."
    ),
    "`wegs bake` searches all training views for what it may leave out; its seconds include that.",
)


@torch.no_grad()
def baking_figure(trained: TrainedRun, views: int, report: Report, budget: float) -> Figure:
    """`wegs bake` beside every SH degree and share of pruned Gaussians, for a run.
    views: how many training views, evenly spread, give the errors.

    budget: see `stopwatch.timed`.
    """
    rasterizer = trained.rasterizer
    training = [trained.camera(photo) for photo in trained.collection.split("train")]
    solid = trained.solid_count
    largest = largest_contributions(trained.splats, training, rasterizer, partial(report.progress, "Views"))
    largest[solid:] = torch.inf
    order = torch.sort(largest, stable=True).indices
    cameras = spread_over(training, views)
    neutral = neutral_look(trained)
    whole = bake(trained, neutral)
    truth = [rasterizer.render(whole, camera, trained.background).clamp(0, 1) for camera in cameras]
    points = []
    shares = [share for share in SHARES if round(share * solid) < len(order)]  # a file holds one Gaussian at the least
    total = len(shares) * (whole.degree + 1) + 1
    with scratch("bench") as folder:
        path = folder / "look.ply"

        def written(baked: Splats) -> Splats:
            core.export.write(path, baked.in_world(trained.collection.frame), "bench")
            return baked

        def pruned(rows: Int[Tensor, " r"], degree: int) -> Splats:
            return bake(trained, neutral, rows).up_to_degree(degree)

        def add(curve: str, label: str, make: Callable[[], Splats], is_default: bool = False) -> None:
            baked, seconds = timed(lambda: written(make()), budget)
            pictures, drawing = timed(
                lambda: [rasterizer.render(baked, camera, trained.background) for camera in cameras], budget
            )
            apart = differences([picture.clamp(0, 1) for picture in pictures], truth)
            values = {
                "megabytes": Spread.exactly(path.stat().st_size / 1e6),
                "seconds": seconds,
                "milliseconds": drawing.scaled(1000 / len(cameras)),
                "rms_steps": apart["rms_error"].scaled(255),
                "max_steps": apart["max_error"].scaled(255),
            }
            points.append(Point(curve, label, values, is_default))
            report.progress("Baking", len(points), total, f"{curve}, {label}")

        add(
            "wegs bake",
            "pruned within its bound",
            lambda: pruner_of(trained, QUIET)(bake(trained, neutral)).splats,
            is_default=True,
        )
        for degree in range(whole.degree, -1, -1):
            for share in shares:
                rows = order[round(share * solid) :].sort().values
                is_all = share == 0 and degree == whole.degree
                label = "everything (--prune off)" if is_all else f"{share:.0%} pruned"
                add(f"SH degree {degree}", label, partial(pruned, rows, degree))
    title = f"Baking {trained.folder.resolve().name}: {counted(len(whole), 'Gaussian')} of degree {whole.degree}"
    return Figure("baking", title, QUANTITIES, PANELS, tuple(points), made_on(trained.settings.seed), NOTES)
