"""The pictures of an evaluation: a sheet with a row for each photo (photo | render | mask, if any | error),
and all of them one by one."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from core.evaluation import WAYS
from core.evaluation.protocols import ViewPictures
from core.export.labelled_sheet import labelled_sheet
from core.export.pictures import tile, tile_size, write_png
from core.system.atomic import filling, write_json

# Folders of renders and photos, a file on how they were made, and the names of the protocols, all as nerfbaselines
# reads them.
PARTS, INFO = ("color", "gt-color"), "info.json"
NERFBASELINES = {"half": "nerfw", "full": "default"}
FULL_ERROR = 0.5  # mean |difference| over the channels that is drawn in the brightest colour


def error_picture(photo: UInt8[np.ndarray, "h w 3"], render: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """The mean |difference| over the channels as a colour map from black (0) to pale yellow (FULL_ERROR and above)."""
    difference = cv2.absdiff(photo, render).mean(axis=2, dtype=np.float32) / (255 * FULL_ERROR)
    levels = (difference.clip(0, 1) * 255).round().astype(np.uint8)
    return cv2.cvtColor(cv2.applyColorMap(levels, cv2.COLORMAP_INFERNO), cv2.COLOR_BGR2RGB)


def titles(protocol: str, step: int, looks: str, masked: bool) -> tuple[str, ...]:
    """The titles of the columns. step: of the run, when it was measured.
    looks: those shown, in words; empty for a run with only one."""
    render, error = (f"render ({looks})", f"error ({looks}; ") if looks else ("render", "error (")
    mask = ("mask (white: static)",) if masked else ()
    return f"photo (protocol {protocol}, step {step})", render, *mask, f"{error}brightest: {FULL_ERROR})"


@dataclass(frozen=True)
class Row:
    """A row of the sheet, already shrunk so that many fit into memory. tiles: of one size, RGB, one for each title."""

    line: str
    look: str | None
    masked: bool
    tiles: tuple[UInt8[np.ndarray, "h w 3"], ...]


def row_of(view: ViewPictures, note: str) -> Row:
    """The row of a view. note: text beside its name, such as its figures."""
    masks = () if view.mask is None else (_mask_picture(view.mask, tile_size(view.photo)),)
    tiles = tile(view.photo), tile(view.render), *masks, tile(error_picture(view.photo, view.render))
    return Row(f"{view.name}  {note}", view.look, view.mask is not None, tiles)


def picture_sheet(rows: Sequence[Row], protocol: str, step: int) -> UInt8[np.ndarray, "sheet_h sheet_w 3"]:
    """A line of titles, then all rows, each above its line of text; RGB.
    The rows of one run all have masks, or none has."""
    looks = " or ".join(dict.fromkeys(WAYS[row.look] for row in rows if row.look))
    columns = titles(protocol, step, looks, rows[0].masked)
    return labelled_sheet(columns, [(row.line, row.tiles) for row in rows])


@contextmanager
def pictures_kept(folder: Path, protocol: str) -> Iterator[Path]:
    """A temporary folder for `write_view`; its pictures replace those in
    `folder` when the block ends without an error."""
    with filling(folder, (*PARTS, INFO), force=True) as work:
        yield work
        write_json(
            work / INFO, {"evaluation_protocol": NERFBASELINES[protocol], "dataset_metadata": {"color_space": "srgb"}}
        )


def write_view(folder: Path, png: Path, view: ViewPictures) -> None:
    """The render and the photo as the file `png` in both of PARTS in `folder`, which must exist."""
    for part, pixels in zip(PARTS, (view.render, view.photo), strict=True):
        for above in reversed(png.parents):
            (folder / part / above).mkdir(exist_ok=True)
        write_png(folder / part / png, pixels)


def _mask_picture(mask: Float[np.ndarray, "h4 w4"], size: tuple[int, int]) -> np.ndarray:
    grey = cv2.resize((mask * 255).round().astype(np.uint8), size, interpolation=cv2.INTER_LINEAR)
    return cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB)
