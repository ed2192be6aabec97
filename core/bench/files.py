"""A figure in the terminal and as files: CSV, JSON and PNG, each with machine, threads, versions and seed."""

import csv
import io
from dataclasses import asdict
from pathlib import Path
from typing import Any

from core.bench.drawing import draw_png
from core.bench.figure import Figure
from core.errors import BadInput
from core.report import Report
from core.system.atomic import adding, write_bytes, write_json, write_text
from core.system.outputs import check_folder, check_named_as_folder

SUFFIXES = (".csv", ".json", ".png")


def check_free(folder: Path, names: tuple[str, ...], force: bool) -> None:
    """Raise BadInput if `folder` cannot be written in,
    or if a figure of one of these names is in it and not to be replaced; BadSetting if it has the suffix of a file.

    Asked before the minutes of measuring.
    """
    check_named_as_folder(folder, SUFFIXES, "figures go into a folder, several files each")
    check_folder(folder)
    old = figure_files(folder, names)
    if old and not force:
        raise BadInput(f"{old[0]} exists.", "Add --force to replace it, or choose another -o.")


def show(figure: Figure, report: Report) -> None:
    """The figure as a table, what it was made on, and where the defaults lie."""
    header = ("curve", "choice", *(quantity.label for quantity in figure.quantities), "on the front of")
    rows = []
    for point, fronts in zip(figure.points, fronts_of(figure), strict=True):
        cells = [point.values[q.name].words() if q.name in point.values else "-" for q in figure.quantities]
        label = f"{point.label} (default)" if point.is_default else point.label
        rows.append((point.curve, label, *cells, ", ".join(map(str, fronts))))
    report.table(figure.title, rows, header)
    for number, panel in enumerate(figure.panels, 1):
        report.say(f"{number}: {figure.quantity(panel.y).label} over {figure.quantity(panel.x).label}")
    made_on = ", ".join(f"{name} {value}" for name, value in figure.made_on.items())
    for line in (*figure.notes, f"Made on {made_on}", *figure.verdicts()):
        report.say(line)


def save(figure: Figure, folder: Path) -> list[Path]:
    """Write NAME.csv, NAME.json and NAME.png into `folder`, which is made if it is not there; all of them or none."""
    with adding(folder) as work:  # a part of a figure would be in the way of the next call
        write_text(work / f"{figure.name}.csv", csv_of(figure))
        write_json(work / f"{figure.name}.json", json_of(figure))
        write_bytes(work / f"{figure.name}.png", draw_png(figure))
    return figure_files(folder, (figure.name,))


def figure_files(folder: Path, names: tuple[str, ...]) -> list[Path]:
    """The files in `folder` of figures of these names."""
    return [path for name in names for suffix in SUFFIXES if (path := folder / (name + suffix)).exists()]


def fronts_of(figure: Figure) -> list[list[int]]:
    """For each point, the numbers, from 1, of the panels on whose Pareto front it lies."""
    fronts = [figure.front(panel) for panel in figure.panels]
    return [[number for number, front in enumerate(fronts, 1) if point in front] for point in figure.points]


def csv_of(figure: Figure) -> str:
    """A row a point: curve, choice, default, median and quartiles of each quantity, fronts;
    then what it was made on."""
    spreads = [quantity.name + end for quantity in figure.quantities for end in ("", "_low", "_high")]
    fronts = [f"front_{panel.y}_over_{panel.x}" for panel in figure.panels]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["curve", "choice", "default", *spreads, *fronts, *figure.made_on])
    for point, on in zip(figure.points, fronts_of(figure), strict=True):
        cells: list[Any] = []
        for quantity in figure.quantities:
            spread = point.values.get(quantity.name)
            cells += ["", "", ""] if spread is None else [spread.median, spread.low, spread.high]
        flags = [int(number in on) for number in range(1, len(figure.panels) + 1)]
        table.writerow([point.curve, point.label, int(point.is_default), *cells, *flags, *figure.made_on.values()])
    return text.getvalue()


def json_of(figure: Figure) -> dict[str, Any]:
    """Everything that the figure holds, and the fronts."""
    values = asdict(figure)
    for entry, fronts in zip(values["points"], fronts_of(figure), strict=True):
        entry["fronts"] = fronts
    return values | {"verdicts": figure.verdicts()}
