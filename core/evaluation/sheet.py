"""What to look at of an evaluation: a sheet with a row a photo, photo | render | mask | error; and the pictures one by one."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from core.data.collection import place_of
from core.evaluation.protocols import ViewPictures
from core.export.pictures import write_png

TILE_PX = 320  # widest picture of a sheet; wider ones are shrunk
LABEL_PX = 22  # height of a line of text
GAP_PX = 4
FULL_ERROR = 0.5  # the mean |difference| over the channels that gets the brightest colour
BLANK = 32  # grey of a tile without a picture
TEXT = (230, 230, 230)


def error_picture(photo: UInt8[np.ndarray, "h w 3"], render: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """The mean |difference| over the channels as a colour map from black (0) to pale yellow (FULL_ERROR and above)."""
    difference = np.abs(photo.astype(np.float32) - render.astype(np.float32)).mean(axis=2) / (255 * FULL_ERROR)
    levels = (difference.clip(0, 1) * 255).round().astype(np.uint8)
    return cv2.cvtColor(cv2.applyColorMap(levels, cv2.COLORMAP_INFERNO), cv2.COLOR_BGR2RGB)


def titles(protocol: str, embedding: str) -> tuple[str, str, str, str]:
    """What stands above the columns."""
    error = f"error ({embedding}; brightest: {FULL_ERROR})"
    return f"photo (protocol {protocol})", f"render ({embedding})", "mask (white: static)", error


def picture_sheet(rows: Sequence[ViewPictures], notes: Sequence[str], protocol: str) -> UInt8[np.ndarray, "sheet_h sheet_w 3"]:
    """All rows below a line of titles, each above a line with its name and its note (a figure, say); RGB.

    A row without a mask has a grey tile there.
    """
    widest = max(min(TILE_PX, row.photo.shape[1]) for row in rows)
    step = widest + GAP_PX
    columns = titles(protocol, " or ".join(dict.fromkeys(row.embedding for row in rows)))
    parts = [_line(step, columns)]
    for row, note in zip(rows, notes, strict=True):
        parts.append(_row(row, widest))
        parts.append(_line(step * len(columns), (f"{row.name}  {note}",)))
    return np.concatenate(parts)


def write_views(folder: Path, views: Sequence[ViewPictures]) -> None:
    """The renders as PNG in color/ of `folder`, the photos in gt-color/, named as the photos: as nerfbaselines lays them out."""
    for view in views:
        for part, pixels in (("color", view.render), ("gt-color", view.photo)):
            path = folder / part / place_of(view.name).with_suffix(".png")
            path.parent.mkdir(parents=True, exist_ok=True)
            write_png(path, pixels)


def _row(row: ViewPictures, widest: int) -> np.ndarray:
    height, width = row.photo.shape[:2]
    share = min(1.0, widest / width)
    size = max(1, round(width * share)), max(1, round(height * share))
    pictures = [row.photo, row.render, _mask_picture(row.mask, size), error_picture(row.photo, row.render)]
    canvas = np.zeros((size[1] + GAP_PX, (widest + GAP_PX) * len(pictures), 3), dtype=np.uint8)
    for column, picture in enumerate(pictures):
        left = column * (widest + GAP_PX)
        tile = picture if picture.shape[1::-1] == size else cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        canvas[: size[1], left : left + size[0]] = tile
    return canvas


def _mask_picture(mask: Float[np.ndarray, "h4 w4"] | None, size: tuple[int, int]) -> np.ndarray:
    if mask is None:
        return np.full((size[1], size[0], 3), BLANK, dtype=np.uint8)
    grey = cv2.resize((mask.clip(0, 1) * 255).round().astype(np.uint8), size, interpolation=cv2.INTER_LINEAR)
    return cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB)


def _line(step: int, texts: Sequence[str]) -> np.ndarray:
    canvas = np.zeros((LABEL_PX, step * len(texts), 3), dtype=np.uint8)
    for column, text in enumerate(texts):
        window = np.zeros((LABEL_PX, step, 3), dtype=np.uint8)  # a text too long for its column ends there
        cv2.putText(window, text, (4, LABEL_PX - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.42, TEXT, 1, cv2.LINE_AA)
        canvas[:, column * step : (column + 1) * step] = window
    return canvas
