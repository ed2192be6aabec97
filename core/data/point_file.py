"""Points from a .ply: positions and, where it has them, colours. Nothing else of the file is looked at."""

from pathlib import Path

import numpy as np

from core.errors import BadInput
from core.ply_file import read_rows

PLACE, COLOUR = ("x", "y", "z"), ("red", "green", "blue")
GREY = 0.5  # of points without colours


def read_points_file(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions (P, 3) float64 and colours (P, 3) float32 in [0, 1], of a .ply in any of the three forms.

    Colours of whole numbers are divided by the largest of their type. Raises BadInput for what cannot be read.
    """
    rows = read_rows(path, ".ply of points")
    if not _has_numbers(rows, PLACE):
        raise BadInput(f"{path} has no numbers x, y and z.", "Write it again, or take it out of the scene's description.")
    positions = np.stack([rows[name].astype(np.float64) for name in PLACE], axis=1)
    if not _has_numbers(rows, COLOUR):
        return positions, np.full(positions.shape, GREY, np.float32)
    largest = [np.iinfo(rows[name].dtype).max if rows.dtype[name].kind in "iu" else 1 for name in COLOUR]
    colours = np.stack([rows[name] / most for name, most in zip(COLOUR, largest, strict=True)], axis=1)
    return positions, np.nan_to_num(colours).clip(0, 1).astype(np.float32)


def _has_numbers(rows: np.ndarray, columns: tuple[str, ...]) -> bool:
    """Whether these columns are there and hold no lists."""
    return all(name in rows.dtype.names and rows.dtype[name].kind in "fiu" for name in columns)
