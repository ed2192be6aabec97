"""The pixels of a photo file as they are stored, in 8-bit sRGB."""

from contextlib import suppress
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image, ImageCms

from core.data.photos.file import TRUNCATED, Header, bad_photo, opened, swaps_sides

REDUCTIONS = (8, 4, 2)  # at which a JPEG can be decoded
MISALIGNED_PX = 0.1  # a reduced JPEG is rounded up to whole pixels, which may shift the wanted picture by this much
GREYS = ("1", "L", "LA")  # Pillow's names of grey pictures of 8 bits and less
FILL = 128  # what a JPEG decoder paints where the data ran out


def read_stored(path: Path, wanted: tuple[int, int] | None = None) -> tuple[Header, np.ndarray, np.ndarray | None]:
    """The header, pixels as stored (H, W, 3) uint8 RGB, and alpha (H, W) uint8, None where all of it is opaque.

    Colours of an ICC profile become those of sRGB. A JPEG may come shrunk, but not below `wanted` (width, height as
    displayed). Raises BadInput for what is missing, truncated or no photo.
    """
    with opened(path) as (header, picture):
        factor = reduction(header, wanted)
        picture.draft(None, (header.width // factor, header.height // factor))
        if header.is_jpeg and _runs_out(picture):
            raise bad_photo(path, f"{TRUNCATED}, or has a grey border below, which is to be cut off")
        if picture.mode.startswith("I;16"):
            picture = _in_8_bits(picture)
        alpha = None
        if picture.has_transparency_data:
            picture = picture.convert("LA" if picture.mode in GREYS else "RGBA")
            alpha = np.array(picture.getchannel("A"))
        pixels = np.array(_in_srgb(picture, header.profile))
    if alpha is not None and alpha.min() == 255:
        alpha = None
    if header.kind == "TIFF":  # which Pillow has turned upright
        pixels = as_stored(pixels, header.orientation)
        alpha = None if alpha is None else as_stored(alpha, header.orientation)
    return header, pixels, alpha


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Stored pixels (H, W, ...) as displayed; orientation: EXIF's 1..8."""
    if swaps_sides(orientation):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return np.ascontiguousarray(pixels)


def as_stored(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """The inverse of `upright`."""
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return np.ascontiguousarray(pixels.swapaxes(0, 1) if swaps_sides(orientation) else pixels)


def reduction(header: Header, wanted: tuple[int, int] | None) -> int:
    """The largest of 8, 4, 2, 1 that leaves at least the wanted size (as displayed) and keeps the picture aligned."""
    if wanted is None or not header.is_jpeg:
        return 1
    sides = tuple(zip(header.displayed, wanted, strict=True))
    for factor in REDUCTIONS:
        if all(side >= factor * want and (-side % factor) * want <= MISALIGNED_PX * side for side, want in sides):
            return factor
    return 1


def _runs_out(picture: Image.Image) -> bool:
    """Whether the last row has the decoder's grey:
    the data ran out, although there is an end marker, as some servers append one."""
    last = np.asarray(picture.crop((0, picture.height - 1, *picture.size)))
    return bool((last == FILL).all()) and not (np.asarray(picture) == FILL).all()


def _in_8_bits(picture: Image.Image) -> Image.Image:
    """A grey picture of 16 bits in 8 bits. If no value is above 255, as in some masks, the values stay."""
    shades = np.asarray(picture)
    return Image.fromarray((shades if shades.max() < 256 else shades >> 8).astype(np.uint8))


def _in_srgb(picture: Image.Image, profile: bytes) -> Image.Image:
    """The picture in RGB, without its alpha. A profile for another kind of colours, such as CMYK, is ignored."""
    if profile:
        kind = "L" if picture.mode in GREYS else "RGB"
        of_its_kind = picture if picture.mode in ("L", "CMYK") else picture.convert(kind)
        with suppress(ImageCms.PyCMSError):
            to_srgb = ImageCms.buildTransform(BytesIO(profile), ImageCms.createProfile("sRGB"), of_its_kind.mode, "RGB")
            return to_srgb.apply(of_its_kind)
    return picture if picture.mode == "RGB" else picture.convert("RGB")
