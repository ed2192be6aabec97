"""What to look at of an evaluation: a sheet with a row a photo, photo | render | mask | error; and the pictures one by one."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from core.evaluation.protocols import ViewPictures
from core.export.pictures import write_png

PARTS = ("color", "gt-color")  # folders of renders and photos, as nerfbaselines names them
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


def titles(protocol: str, step: int, embedding: str) -> tuple[str, str, str, str]:
    """What stands above the columns. step: after which the run was measured."""
    error = f"error ({embedding}; brightest: {FULL_ERROR})"
    return f"photo (protocol {protocol}, step {step})", f"render ({embedding})", "mask (white: static)", error


@dataclass(frozen=True)
class Row:
    """A photo on the sheet, shrunk already, so that many can wait for the others. tiles: of one size, RGB."""

    line: str
    embedding: str
    tiles: tuple[UInt8[np.ndarray, "h w 3"], ...]


def row_of(view: ViewPictures, note: str) -> Row:
    """The row of a view; `note` (a figure, say) stands beside its name. Without a mask there is a grey tile in its place."""
    height, width = view.photo.shape[:2]
    share = min(1.0, TILE_PX / width)
    size = max(1, round(width * share)), max(1, round(height * share))
    pictures = view.photo, view.render, _mask_picture(view.mask, size), error_picture(view.photo, view.render)
    tiles = (one if one.shape[1::-1] == size else cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in pictures)
    return Row(f"{view.name}  {note}", view.embedding, tuple(tiles))


def picture_sheet(rows: Sequence[Row], protocol: str, step: int) -> UInt8[np.ndarray, "sheet_h sheet_w 3"]:
    """All rows below a line of titles, each above a line with its name and its note; RGB."""
    width = max(row.tiles[0].shape[1] for row in rows) + GAP_PX
    columns = titles(protocol, step, " or ".join(dict.fromkeys(row.embedding for row in rows)))
    parts = [_line(width, columns)]
    for row in rows:
        parts.append(_side_by_side(row.tiles, width))
        parts.append(_line(width * len(columns), (row.line,)))
    return np.concatenate(parts)


def write_view(folder: Path, place: Path, view: ViewPictures) -> None:
    """The render and the photo as the PNG `place` in PARTS of `folder`."""
    for part, pixels in zip(PARTS, (view.render, view.photo), strict=True):
        path = folder / part / place
        path.parent.mkdir(parents=True, exist_ok=True)
        write_png(path, pixels)


def _side_by_side(tiles: Sequence[np.ndarray], step: int) -> np.ndarray:
    height, width = tiles[0].shape[:2]
    canvas = np.zeros((height + GAP_PX, step * len(tiles), 3), dtype=np.uint8)
    for column, tile in enumerate(tiles):
        canvas[:height, column * step : column * step + width] = tile
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
