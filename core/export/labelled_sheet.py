"""A sheet of pictures with text: a line of titles, then rows of pictures, each above a line of text."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import UInt8

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
    smaller if it is too long for them, and at last cut."""
    windows = np.zeros((len(texts), LABEL_PX, step, 3), dtype=np.uint8)
    for window, text in zip(windows, texts, strict=True):
        # OpenCV ends the program at bytes of a file name that are no letters.
        text = text.encode(errors="replace").decode()
        (usual_px, _), _ = cv2.getTextSize(text, FONT, SIZES[1], 1)
        size = np.clip(SIZES[1] * (step - 2 * MARGIN_PX) / max(usual_px, 1), *SIZES)
        cv2.putText(window, text, (MARGIN_PX, 15), FONT, size, TEXT, 1, cv2.LINE_AA)
    return np.concatenate(windows, axis=1)
