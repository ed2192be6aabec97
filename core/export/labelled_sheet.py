"""A sheet of pictures with text: a line of titles, then rows of pictures, each above a line of text."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import UInt8

from core.words import on_one_line

LABEL_PX = 28  # height of a line of text, which stands in its upper part: it belongs to the pictures above
GAP_PX = 4
MARGIN_PX = 4  # beside a text
FONT = cv2.FONT_HERSHEY_SIMPLEX
SIZES = (0.3, 0.42)  # the smallest that can be read, and the usual
TEXT = (230, 230, 230)


def labelled_sheet(
    columns: Sequence[str], rows: Sequence[tuple[str, Sequence[UInt8[np.ndarray, "_ _ 3"]]]]
) -> UInt8[np.ndarray, "sheet_h sheet_w 3"]:
    """The sheet, RGB. columns: the titles. rows: text and tiles, one tile a column, of one size."""
    step = max(tiles[0].shape[1] for _, tiles in rows) + GAP_PX
    parts = [line_of_text(step, columns)]
    for text, tiles in rows:
        parts.append(
            np.concatenate([np.pad(tile, ((0, GAP_PX), (0, step - tile.shape[1]), (0, 0))) for tile in tiles], axis=1)
        )
        parts.append(line_of_text(step * len(columns), (text,)))
    return np.concatenate(parts)


def line_of_text(step: int, texts: Sequence[str]) -> UInt8[np.ndarray, "label_h sheet_w 3"]:
    """One line, white on black: each text at the start of its own `step` pixels,
    smaller if it is too long for them, and at last without its middle."""
    windows = np.zeros((len(texts), LABEL_PX, step, 3), dtype=np.uint8)
    for window, text in zip(windows, texts, strict=True):
        # OpenCV ends the program at bytes of a file name that are no letters.
        text, size = _fitted(on_one_line(text.encode(errors="replace").decode()), step - 2 * MARGIN_PX)
        cv2.putText(window, text, (MARGIN_PX, 15), FONT, size, TEXT, 1, cv2.LINE_AA)
    return np.concatenate(windows, axis=1)


def _fitted(text: str, room_px: int) -> tuple[str, float]:
    """The text, without its middle if even the smallest of SIZES is too large for `room_px`, and its size.
    What a text begins and ends with, a photo's name and its figures, is what tells it from others."""
    smallest, usual = SIZES
    size = float(np.clip(usual * room_px / max(_width_px(text, usual), 1), smallest, usual))
    if size > smallest or _width_px(text, size) <= room_px:
        return text, size
    shorter = (f"{text[:kept]}...{text[-kept:]}" for kept in range(len(text) // 2, 0, -1))
    return next((short for short in shorter if _width_px(short, size) <= room_px), text), size


def _width_px(text: str, size: float) -> int:
    return cv2.getTextSize(text, FONT, size, 1)[0][0]
