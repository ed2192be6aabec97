"""Points from a .ply: positions and, if it has them, colours; anything else in the file is ignored."""

from pathlib import Path

import numpy as np

from core.errors import BadInput
from core.ply_file import read_rows

PLACE, COLOUR = ("x", "y", "z"), ("red", "green", "blue")
GREY = 0.5  # of points without colours
WHITE = {"u1": 255.0, "u2": 65535.0}  # the value of full colour, by type
WHITE_OF_OTHERS = 255.0  # of other integers, and of floats beyond BRIGHTEST
BRIGHTEST = 2.0  # floats up to this are taken to be in [0, 1]: colours computed from light may exceed 1 a little


def read_points_file(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions (P, 3) float64 and colours (P, 3) float32 in [0, 1] of a .ply in any of its three encodings.

    Unsigned colours of 8 or 16 bits are divided by their type's largest value. Other integers, and floats if any is
    above BRIGHTEST, are taken for 8 bits (0 to 255). Colours that are not finite become black. Raises BadInput for a
    file that cannot be read.
    """
    rows = read_rows(path, ".ply of points")
    if not _has_numbers(rows, PLACE):
        raise BadInput(
            f"{path} has no numbers x, y and z.", "Write it again, or take it out of the scene's description."
        )
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
    """Whether these columns exist and hold numbers, not lists."""
    return all(name in (rows.dtype.names or ()) and rows.dtype[name].kind in "fiu" for name in columns)
