"""history.csv of a run folder: how its training went, with a row now and then."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from core.errors import BadInput, as_disk_full
from core.system.atomic import write_text

FILE = "history.csv"
HELD_OUT = "held_out_psnr"  # the column (dB) that only rows with a check of quality fill


def add_row(folder: Path, columns: Sequence[str], row: Mapping[str, Any]) -> None:
    """Append a row; a new file begins with the names of the columns.
    Raises DiskFull, or OSError with the name of the file."""
    path = folder / FILE
    try:
        with path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns, extrasaction="ignore")
            if not file.tell():
                writer.writeheader()
            writer.writerow(row)
    except OSError as problem:
        if full := as_disk_full(problem, path):
            raise full from None
        problem.filename = str(path)  # not told where writing fails, only where opening does
        raise


def checks(folder: Path) -> list[dict[str, float]]:
    """The rows with a check of held-out quality, in order, what was not recorded left out; none without a file.

    Garbled rows and one cut short, as a killed program or a full disk leaves them, are left out, too. Raises BadInput
    for a folder in place of the file, OSError for a file that cannot be read.
    """
    names, *rows = [line.rstrip().split(",") for line in _whole_lines(folder)] or [[]]
    return [numbers for row in rows if HELD_OUT in (numbers := _numbers(names, row))]


def _numbers(names: list[str], row: list[str]) -> dict[str, float]:
    """The filled cells of a row; none of a garbled one."""
    try:
        return {name: float(cell) for name, cell in zip(names, row, strict=True) if cell}
    except ValueError:
        return {}


def _whole_lines(folder: Path) -> list[str]:
    if (folder / FILE).is_dir():
        raise BadInput(f"{folder / FILE} is a folder.", "Move it away.")
    try:
        with (folder / FILE).open(encoding="utf-8", errors="replace", newline="") as file:
            return [line for line in file if line.endswith("\n")]
    except FileNotFoundError:
        return []


def rewind(folder: Path, step: int) -> None:
    """Take out what a killed run did after its last checkpoint, at `step`, and will do again."""
    lines = _whole_lines(folder)
    if not lines:
        (folder / FILE).unlink(missing_ok=True)  # not even the names of its columns are whole
        return

    def is_done(line: str) -> bool:
        number = line.partition(",")[0]  # none in a garbled line, which goes too
        # int() would refuse the thousands of digits of a garbled one.
        return number.isdecimal() and float(number) <= step

    write_text(folder / FILE, "".join([lines[0], *filter(is_done, lines[1:])]))
