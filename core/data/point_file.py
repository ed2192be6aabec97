"""Points from a .ply: positions and, where it has them, colours. Nothing else of the file is looked at."""

from pathlib import Path

import numpy as np

from core.errors import BadInput
from core.ply_file import read_rows

PLACE, COLOUR = ("x", "y", "z"), ("red", "green", "blue")
GREY = 0.5  # of points without colours
WHITE = {"u1": 255.0, "u2": 65535.0}  # of colours by their type
WHITE_OF_OTHERS = 255.0  # whole numbers, and floats too bright for [0, 1]
BRIGHTEST = 2.0  # of floats in [0, 1], which burn out where they were computed from light


def read_points_file(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions (P, 3) float64 and colours (P, 3) float32 in [0, 1], of a .ply in any of the three forms.

    Colours of 8 or 16 bits without a sign are divided by the largest of their type. Other whole numbers hold 8 bits (what NumPy makes
    of them by itself), and so do floats of which any is above BRIGHTEST. What is not finite is black. Raises BadInput for what
    cannot be read.
    """
    rows = read_rows(path, ".ply of points")
    if not _has_numbers(rows, PLACE):
        raise BadInput(f"{path} has no numbers x, y and z.", "Write it again, or take it out of the scene's description.")
    positions = np.stack([rows[name].astype(np.float64) for name in PLACE], axis=1)
    if not _has_numbers(rows, COLOUR):
        return positions, np.full(positions.shape, GREY, np.float32)
    channels = [np.nan_to_num(rows[name], posinf=0, neginf=0) for name in COLOUR]
    colours = np.stack(channels, axis=1) / max(map(_white, channels))
    return positions, colours.clip(0, 1).astype(np.float32)


def _white(channel: np.ndarray) -> float:
    """The number that stands for full red, green or blue in a channel."""
    if channel.dtype.kind == "f" and not (channel > BRIGHTEST).any():
        return 1.0
    return WHITE.get(channel.dtype.str[1:], WHITE_OF_OTHERS)


def _has_numbers(rows: np.ndarray, columns: tuple[str, ...]) -> bool:
    """Whether these columns are there and hold no lists."""
    return all(name in rows.dtype.names and rows.dtype[name].kind in "fiu" for name in columns)
