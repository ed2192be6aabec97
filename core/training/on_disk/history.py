"""history.csv of a run folder: how its training went, a row now and then."""

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from core.system.atomic import write_text

FILE = "history.csv"
HELD_OUT = "held_out_psnr"  # the column (dB) that only rows with a check of quality fill


@contextmanager
def appended(folder: Path, columns: Sequence[str]) -> Iterator[Callable[[Mapping[str, Any]], None]]:
    """A function that adds a row, which is on disk when it returns; a new file begins with the names of the columns."""
    with (folder / FILE).open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        if not file.tell():
            writer.writeheader()

        def add(row: Mapping[str, Any]) -> None:
            writer.writerow({name: row[name] for name in columns})
            file.flush()

        yield add


def checks(folder: Path) -> list[dict[str, float]]:
    """The rows with a check of held-out quality, in order, what was not recorded left out; none without a file.

    Garbled rows, as a killed program or a full disk leaves them, are left out, too. Raises OSError for a file that cannot be read.
    """
    try:
        with (folder / FILE).open(encoding="utf-8", errors="replace", newline="") as file:
            return [row for row in map(_numbers, csv.DictReader(file)) if HELD_OUT in row]
    except FileNotFoundError:
        return []


def _numbers(row: dict[str | None, Any]) -> dict[str, float]:
    """The filled cells of a row; none of a garbled one."""
    try:
        return {name: float(cell) for name, cell in row.items() if cell}
    except (TypeError, ValueError):
        return {}


def rewind(folder: Path, step: int) -> None:
    """Take out what a killed run did after its last checkpoint, at `step`, and will do again."""
    path = folder / FILE
    if not path.is_file():
        return
    with path.open(encoding="utf-8", errors="replace", newline="") as file:
        lines = file.readlines()

    def is_done(line: str) -> bool:
        number = line.partition(",")[0]  # none in a garbled line, which goes too
        return line.endswith("\n") and number.isdecimal() and int(number) <= step

    write_text(path, "".join([*lines[:1], *filter(is_done, lines[1:])]))
