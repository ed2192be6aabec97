"""Renders as files to look at: PNG pictures, contact sheets, videos."""

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image
from torch import Tensor

from core.errors import WegsError
from core.export.labelled_sheet import line_of_text
from core.system.atomic import replacing, write_bytes

cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # errors with videos are reported here, once

SHEET_COLUMNS = 5  # at most
TILE_PX = 320  # widest picture of a sheet; wider ones are shrunk
VIDEO_SECONDS, MOST_FPS = 3.0, 30.0  # the length with few frames, and the rate with many, which then take longer
# VP9, which browsers and editors play; if OpenCV lacks it, MPEG-4 part 2, which they do not.
VIDEO_CODECS = "vp09", "mp4v"


def levels(image: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
    """The picture in the steps of an 8-bit file: clamped to [0, 1], times 255 and rounded. NaN stays NaN."""
    return (image.detach().clamp(0, 1) * 255).round()


def to_8_bit(image: Float[Tensor, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """A rendering as pixels."""
    return levels(image).byte().cpu().numpy()


def write_png(path: Path, pixels: UInt8[np.ndarray, "h w *rgb"]) -> None:
    """Write RGB or grey pixels, whole or not at all."""
    data = cv2.imencode(".png", pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))[1]
    write_bytes(path, data.tobytes())  # imwrite would not report a full disk


class KeptPictures(Sequence):
    """The pictures of PNG files, RGB, each read when it is needed:
    the frames of a long fade would not fit into memory together."""

    def __init__(self, paths: Sequence[Path]):
        self.paths = paths

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, number: int) -> UInt8[np.ndarray, "h w 3"]:  # type: ignore[override]  # no slices
        return np.array(Image.open(self.paths[number]))  # OpenCV would end the program at a path that is not in UTF-8


def tile_size(picture: UInt8[np.ndarray, "h w 3"]) -> tuple[int, int]:
    """The size of the picture on a sheet: shrunk to a width of TILE_PX if it is wider."""
    height, width = picture.shape[:2]
    share = min(1.0, TILE_PX / width)
    return max(1, round(width * share)), max(1, round(height * share))


def tile(picture: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "tile_h tile_w 3"]:
    """The picture at its `tile_size`."""
    size = tile_size(picture)
    return picture if picture.shape[1::-1] == size else cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


def contact_sheet(title: str, frames: Sequence[UInt8[np.ndarray, "h w 3"]]) -> UInt8[np.ndarray, "sheet_h sheet_w 3"]:
    """A line of text, then all frames (of one size), shrunk, in reading order, in as few and as even rows as possible;
    unused tiles are white."""
    width, height = tile_size(frames[0])
    rows = math.ceil(len(frames) / SHEET_COLUMNS)
    columns = math.ceil(len(frames) / rows)
    sheet = np.full((rows * height, columns * width, 3), 255, dtype=np.uint8)
    for number, frame in enumerate(frames):
        top, left = number // columns * height, number % columns * width
        sheet[top : top + height, left : left + width] = tile(frame)
    return np.concatenate([line_of_text(columns * width, [title]), sheet])


def write_video(path: Path, frames: Sequence[UInt8[np.ndarray, "h w 3"]]) -> None:
    """Write an .mp4 of VIDEO_SECONDS, or longer at MOST_FPS. Frames, of one size, lose an odd last row or column.

    Raises WegsError where OpenCV cannot begin or end it, and as core.system.atomic.replacing.
    """
    height, width = (side - side % 2 for side in frames[0].shape[:2])  # the codec stores colour at half the size
    with replacing(path) as temporary:
        file = str(temporary.absolute())  # FFmpeg takes anything before a colon for a protocol
        if file != file.encode(errors="replace").decode():  # OpenCV would end the program
            raise WegsError(f"{path} could not be written: its path is not in UTF-8.", "Use the frames instead.")
        for codec in VIDEO_CODECS:
            writer = cv2.VideoWriter(
                file, cv2.VideoWriter.fourcc(*codec), min(len(frames) / VIDEO_SECONDS, MOST_FPS), (width, height)
            )
            if writer.isOpened():
                break
        else:
            what = f"{path} could not be written: OpenCV begins no video of {width} x {height} px"
            raise WegsError(f"{what}.", "Use the frames instead.")
        for frame in frames:
            writer.write(cv2.cvtColor(frame[:height, :width], cv2.COLOR_RGB2BGR))
        writer.release()
        if not cv2.VideoCapture(file).isOpened():  # the writer says nothing, but its index comes last
            raise WegsError(f"{path} could not be written whole.", "Check whether the disk is full.")
