"""The pixels of photos: as displayed, undistorted, at the size wanted."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from core.data import lens as lenses
from core.data.collection import Photo
from core.data.photo_file import TRUNCATED, Header, bad_photo, read_header

REDUCTIONS = {8: cv2.IMREAD_REDUCED_COLOR_8, 4: cv2.IMREAD_REDUCED_COLOR_4, 2: cv2.IMREAD_REDUCED_COLOR_2}
MISALIGNED_PX = 0.1  # a reduced JPEG is rounded up to whole pixels; it may be off by this much of the wanted picture
FILL = 128  # what a JPEG decoder paints where the data ran out


@dataclass(frozen=True)
class Picture:
    """pixels: (h, w, 3) uint8 RGB. valid: (h, w) bool, False where the photo shows nothing; None where all is valid."""

    pixels: np.ndarray
    valid: np.ndarray | None


def read(path: Path) -> np.ndarray:
    """A photo as displayed: (H, W, 3) uint8 RGB, EXIF rotation applied.

    Grey, 16-bit (the upper 8 bits), palette and CMYK photos are converted; transparency is laid on white, as viewers do.
    Raises BadInput for what is missing, truncated or no photo.
    """
    header, pixels, alpha = _decode(Path(path))
    return upright(_on_white(pixels, alpha), header.orientation)


def load(photo: Photo, width: int, height: int) -> Picture:
    """A photo of a collection, undistorted, at `width` x `height` px: what photo.camera.resized(width, height) sees.

    A JPEG much larger than that is decoded at 1/2, 1/4 or 1/8. Shrinking averages over areas. Invalid are pixels that the
    lens did not see and those with any transparency. Raises BadInput like `read`.
    """
    header, pixels, alpha = _decode(Path(photo.path), (width, height))
    pixels = _on_white(pixels, alpha)
    valid = None if alpha is None else alpha == 255
    if photo.lens is None:
        pixels = upright(pixels, header.orientation)
        valid = None if valid is None else upright(valid, header.orientation)
    else:
        pixels, valid = _undistort(pixels, valid, photo, header)
    return Picture(_resize(pixels, width, height), _resize_valid(valid, width, height))


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Stored pixels (H, W, ...) as displayed; orientation: EXIF's 1..8."""
    if orientation >= 5:
        pixels = pixels.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return np.ascontiguousarray(pixels)


def _decode(path: Path, wanted: tuple[int, int] | None = None) -> tuple[Header, np.ndarray, np.ndarray | None]:
    """Header, stored pixels (H, W, 3) RGB and alpha (H, W) or None; a JPEG shrunk, but not below `wanted` (width, height as displayed)."""
    try:
        data = path.read_bytes()
    except OSError as problem:
        raise bad_photo(path, f"cannot be opened ({problem.strerror})") from None
    if not data:
        raise bad_photo(path, "is empty")
    header = read_header(path, data)
    encoded = np.frombuffer(data, np.uint8)
    if header.kind == "jpeg":
        flags = REDUCTIONS.get(_reduction(header, wanted), cv2.IMREAD_COLOR) | cv2.IMREAD_IGNORE_ORIENTATION
        pixels = cv2.imdecode(encoded, flags)
        if pixels is None:
            raise bad_photo(path, "cannot be decoded")
        if _runs_out(pixels):
            raise bad_photo(path, TRUNCATED)
        return header, cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), None
    with_alpha = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED)  # the only way to alpha; ignores EXIF
    if with_alpha is not None and with_alpha.ndim == 3 and with_alpha.shape[2] == 4:
        if with_alpha.dtype == np.uint16:
            with_alpha = (with_alpha >> 8).astype(np.uint8)
        if with_alpha.dtype == np.uint8:
            return header, cv2.cvtColor(with_alpha, cv2.COLOR_BGRA2RGB), with_alpha[..., 3]
    flags = cv2.IMREAD_COLOR | (cv2.IMREAD_IGNORE_ORIENTATION if header.kind == "png" else 0)
    pixels = cv2.imdecode(encoded, flags)
    if pixels is None:
        raise bad_photo(path, "cannot be decoded")
    return header, cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), None


def _reduction(header: Header, wanted: tuple[int, int] | None) -> int:
    """The largest of 8, 4, 2, 1 that leaves at least the wanted size (as displayed) and keeps the picture aligned."""
    if wanted is None:
        return 1
    for factor in REDUCTIONS:
        sides = tuple(zip(header.displayed, wanted, strict=True))
        if all(side >= factor * want and (-side % factor) * want <= MISALIGNED_PX * side for side, want in sides):
            return factor
    return 1


def _runs_out(pixels: np.ndarray) -> bool:
    """Whether the last row is the decoder's grey: an end marker was put where the data ran out, as some servers do."""
    return bool((pixels[-1] == FILL).all() and not (pixels == FILL).all())


def _on_white(pixels: np.ndarray, alpha: np.ndarray | None) -> np.ndarray:
    if alpha is None:
        return pixels
    share = alpha[..., None].astype(np.float32) / 255
    return np.rint(pixels * share + 255 * (1 - share)).astype(np.uint8)


def _undistort(
    pixels: np.ndarray, valid: np.ndarray | None, photo: Photo, header: Header
) -> tuple[np.ndarray, np.ndarray]:
    """Stored pixels at any size -> the pinhole picture as displayed, and where it is valid."""
    if valid is not None:
        pixels = np.dstack([pixels, valid * np.uint8(255)])
    height, width = pixels.shape[:2]
    if header.orientation >= 5:
        width, height = height, width
    if "orientation" not in photo.lens:  # the lens is that of the picture as displayed
        pixels = upright(pixels, header.orientation)
    found, seen = lenses.undistort(pixels, photo.lens, photo.camera.resized(width, height))
    if valid is not None:
        seen &= found[..., 3] == 255
    return found[..., :3], seen


def _resize(pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    if pixels.shape[:2] == (height, width):
        return np.ascontiguousarray(pixels)
    shrinks = pixels.shape[0] >= height and pixels.shape[1] >= width
    return cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)


def _resize_valid(valid: np.ndarray | None, width: int, height: int) -> np.ndarray | None:
    """A pixel is valid where all that it averages is."""
    if valid is None or valid.all():
        return None
    return _resize(valid * np.uint8(255), width, height) >= 254
