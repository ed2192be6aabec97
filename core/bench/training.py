"""Training: held-out quality over seconds and over steps, from the history.csv that every run records."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from core.bench.figure import Figure, Panel, Point, Quantity, Spread
from core.bench.machine import made_on
from core.errors import BadInput
from core.run import checkpoint, history
from core.run.run_config import read_config

QUANTITIES = (
    Quantity("seconds", "s of training", "log"),
    Quantity("steps", "steps", "log"),
    Quantity("gaussians", "Gaussians"),
    Quantity("psnr", "held-out PSNR, dB", more_is_better=True),
    Quantity("ssim", "held-out SSIM", more_is_better=True),
)
PANELS = tuple(Panel(x, y, labelled=False) for y in ("psnr", "ssim") for x in ("seconds", "steps"))
COLUMNS = {
    "steps": "step",
    "seconds": "seconds",
    "gaussians": "gaussians",
    "psnr": history.HELD_OUT,
    "ssim": "held_out_ssim",
}
NOTES = (
    "A few held-out photos, each in the look that its whole photo gives, unrefined. Seconds without these checks.",
    "Nothing is rounded to 8 bits, and SSIM is padded, as in the loss: `wegs eval` has other figures.",
)


@dataclass(frozen=True)
class Course:
    """Runs that differ in nothing but the seed. name: of the curve. folders: theirs.
    is_default: settings as they come."""

    name: str
    folders: tuple[Path, ...]
    is_default: bool = False


def training_figure(courses: list[Course], title: str, notes: tuple[str, ...] = ()) -> Figure:
    """All courses in one picture, with medians and quartiles over the runs of a course.
    Raises BadInput if held-out quality was never measured."""
    points = [point for course in courses for point in _points(course)]
    seeds = sorted({read_config(folder).settings.seed for course in courses for folder in course.folders})
    return Figure("training", title, QUANTITIES, PANELS, tuple(points), made_on(*seeds), NOTES + notes)


def checks(folder: Path) -> list[dict[str, float]]:
    """The rows of a run's history at which held-out quality was measured; BadInput if there is none."""
    rows = [row for row in history.checks(folder) if row.keys() >= set(COLUMNS.values())]
    if not rows:
        raise BadInput(f"{folder / history.FILE} holds no held-out quality.", _how_to_check(folder))
    return [{name: row[column] for name, column in COLUMNS.items()} for row in rows]


def _how_to_check(folder: Path) -> str:
    config = read_config(folder)
    settings, collection = config.settings, config.collection
    saved = checkpoint.read_newest(folder, checkpoint.read_facts)
    step = saved[1]["step"] if saved else 0
    if not (settings.held_out_checks and collection.split("test")):
        return "Train without --all-photos on a scene with test photos, and with held_out_checks > 0."
    if step < settings.steps:
        return f"Its first check is to come; type: {checkpoint.how_to_go_on(folder)}"
    return "It was removed or damaged after the training, or no held-out photo could be read: train the run again."


def _points(course: Course) -> Iterator[Point]:
    rows = list(zip(*(checks(folder) for folder in course.folders), strict=False))
    for number, at in enumerate(rows):
        values = {name: Spread.of([row[name] for row in at]) for name in COLUMNS}
        is_last = number == len(rows) - 1
        yield Point(course.name, f"step {at[0]['steps']:.0f}", values, course.is_default and is_last)
