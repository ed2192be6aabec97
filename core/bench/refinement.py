"""Refinement: how many dB each step of Adam gains on held-out photos, by both protocols.

The refinement is that of core.appearance.refinement, the regions are those of core.evaluation.protocols: with `half`,
the left half is fitted and the right half measured; with `full`, the whole photo is both, so that its figures have seen
what they are scored on.
"""

import time
from functools import partial
from itertools import islice

import torch

from core.appearance.refinement import LATER_STEPS, STEPS
from core.bench.figure import Figure, Panel, Point, Quantity, Spread
from core.bench.machine import made_on
from core.data.collection import spread_over
from core.errors import BadInput
from core.evaluation.protocols import HeldOutView, fit_of, refining
from core.evaluation.subject import Subject
from core.looks.held_out_views import over_views
from core.looks.trained import TrainedRun
from core.report import Report
from core.words import counted

MEASURED = (0, 1, 2, 4, 8, 16, 32, 64, STEPS, STEPS + LATER_STEPS // 2, STEPS + LATER_STEPS)
NOTES = (
    (
        "Medians and quartiles over photos. half: the right half is scored, which was not seen; full: "
        "what was fitted is scored."
    ),
)


def refinement_figure(
    trained: dict[str, TrainedRun], protocols: tuple[str, ...], photos: int, report: Report
) -> Figure:
    """The course of the refinement on up to `photos` held-out photos of each run.
    trained: runs that have looks, by the names to draw them under.

    Raises BadInput where no held-out photo can be read.
    """
    points, reached, problem = [], set(), None
    for name, run in trained.items():
        chosen = spread_over(run.collection.split("test"), photos)
        for protocol in protocols:
            course_of = partial(_course, run, protocol)
            measured = over_views(
                run,
                chosen,
                course_of,
                f"Refinement of {name}, {protocol}",
                report,
                f"of {name} not measured by {protocol}",
            )
            try:
                courses = [course for _, course in measured]
            except BadInput as found:
                problem = found
                report.warn(f"{name} is not measured by {protocol}: {problem}")
                continue
            reached.add(protocol)
            curve = protocol if len(trained) == 1 else f"{name}, {protocol}"
            points += _points(curve, protocol, courses)
    if problem is not None and not points:
        raise problem
    title = f"Refinement: {', '.join(f'{name} at step {run.step}' for name, run in trained.items())}"
    quantities = [Quantity("steps", "Adam steps", "steps"), Quantity("seconds", "s a photo", "log")]
    panels = []
    # Figures of one protocol are never compared with those of the other: own axes.
    for protocol in [each for each in protocols if each in reached]:
        quantities.append(Quantity(f"gain_{protocol}", f"{protocol}: dB gained", more_is_better=True))
        quantities.append(Quantity(f"psnr_{protocol}", f"{protocol}: PSNR, dB", more_is_better=True))
        panels += [Panel("steps", f"gain_{protocol}", labelled=False), Panel("seconds", f"gain_{protocol}")]
    made = made_on(*sorted({run.settings.seed for run in trained.values()}))
    return Figure("refinement", title, tuple(quantities), tuple(panels), tuple(points), made, NOTES)


def _course(subject: Subject, protocol: str, view: HeldOutView) -> list[dict[str, float]]:
    """The quantities after each number of steps in MEASURED."""
    fit, seen = fit_of(subject, view, protocol), subject.seen_by(view.camera)
    for _ in islice(refining(subject, fit), 2):
        pass  # not measured, because the very first step loads the kernels
    course: list[dict[str, float]] = []
    seconds, since = 0.0, time.perf_counter()
    for step, look in enumerate(refining(subject, fit)):
        seconds += time.perf_counter() - since
        if step in MEASURED:
            with torch.no_grad():
                psnr = fit.psnr(seen.render(look))
            first = course[0]["psnr"] if course else psnr
            course.append({"steps": step, "seconds": seconds, "gain": psnr - first, "psnr": psnr})
        since = time.perf_counter()
    return course


def _points(curve: str, protocol: str, courses: list[list[dict[str, float]]]) -> list[Point]:
    """Medians and quartiles over the photos, a point for each number of steps."""
    points, by_step = [], list(zip(*courses, strict=True))
    for at in by_step:
        spreads = {name: Spread.of([course[name] for course in at]) for name in at[0]}
        values = {name: spreads[name] for name in ("steps", "seconds")}
        values |= {f"{name}_{protocol}": spreads[name] for name in ("gain", "psnr")}
        steps = round(at[0]["steps"])
        points.append(Point(curve, counted(steps, "step"), values, at is by_step[-1]))
    return points
