"""The pixels of photos: as displayed, undistorted, at the size wanted."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from core.data.collection import GivenMask, Photo
from core.data.photos import distortion
from core.data.photos.file import Header, bad_photo, probe, swaps_sides
from core.data.photos.fill import fill
from core.data.photos.stored import as_stored, read_stored, upright
from core.errors import BadInput
from core.scene.camera import Camera
from core.scene.lens import Lens

OVERSAMPLING = 2  # photos are undistorted at up to this times the wanted size: slow beyond, blurred below
OPAQUE = 250  # of 255; programs that blend or convert leave opaque pixels a little below
LIGHT_PX = 2000  # a side; more than enough for light, as the encoder sees a square of 144
GREY = (32, 224)  # neither black nor white
MOST_GREY = 0.5  # share of a mask that may be grey; with more, it is a photo or a map of classes
LEAST_USE = 0.01  # share of a photo; a mask that leaves less is a mistake
MEANING = "White (255) marks what is to be used, black what is not."  # in a mask


@dataclass(frozen=True)
class LoadedPhoto:
    """What a photo's file shows. pixels: (h, w, 3) uint8 RGB.
    valid: (h, w) bool, False where the photo shows nothing; None where all is valid.

    empty: (h, w) uint8, how much of each pixel is empty space, shown as white: 255 all of it; None where nothing is
    empty.
    """

    pixels: np.ndarray
    valid: np.ndarray | None
    empty: np.ndarray | None = None


def read_pixels(path: Path) -> np.ndarray:
    """A photo as displayed: (H, W, 3) uint8 RGB; see `read_pixels_and_alpha`."""
    return read_pixels_and_alpha(path)[0]


def read_pixels_and_alpha(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """A photo as displayed, EXIF rotation applied: (H, W, 3) uint8 RGB;
    and its alpha, (H, W) uint8, None where all of it is opaque.

    Grey, 16-bit (to within one 8-bit step; taken for 8-bit if no value is above 255), palette and CMYK photos are
    converted; transparent pixels are shown over white, as viewers show them. Raises BadInput for what is missing,
    truncated or no photo.
    """
    header, pixels, alpha = read_stored(path)
    shown = upright(_over_white(pixels, alpha), header.orientation)
    return shown, None if alpha is None else upright(alpha, header.orientation)


def read_light(path: Path, mask: Path | None = None) -> np.ndarray:
    """A photo for its light alone: as `read_pixels`,
    but what is transparent or hidden by a mask is filled with the colours around it.

    mask: a picture, white where the photo is to be used. A JPEG of more than twice LIGHT_PX a side may come shrunk.
    Raises BadInput as `read_pixels`, and if nothing of the photo is left.
    """
    header, pixels, alpha = read_stored(path, (LIGHT_PX, LIGHT_PX))
    pixels = upright(pixels, header.orientation)
    use = np.ones(pixels.shape[:2], bool) if alpha is None else upright(alpha, header.orientation) >= OPAQUE
    if mask is not None:
        use &= read_mask(mask, pixels.shape[1::-1])
    return pixels if use.all() else _filled(pixels, use, path, masked=mask is not None)


def load_photo(photo: Photo, width: int, height: int, transparent_is_empty: bool = False) -> LoadedPhoto:
    """A photo of a collection, undistorted, at `width` x `height` px: what photo.camera.resized(width, height) sees.

    A JPEG much larger than that is decoded at 1/2, 1/4 or 1/8. Shrinking averages over areas. Pixels are invalid if the
    lens did not see them, if they are noticeably transparent, or if the photo's mask hides them; those of the last two
    kinds are filled with the colours around. transparent_is_empty: transparent pixels are valid, and count as empty
    space. Raises BadInput like `read_pixels`.
    """
    header, pixels, alpha = read_stored(photo.path, (width, height))
    pixels = _over_white(pixels, alpha)
    valid = None if alpha is None or transparent_is_empty else alpha >= OPAQUE
    if transparent_is_empty and alpha is not None:
        # A fourth channel, to be turned, undistorted and resized with the colours.
        pixels = np.dstack([pixels, 255 - alpha])
    if photo.mask is not None:
        displayed = pixels.shape[:2] if swaps_sides(header.orientation) else pixels.shape[1::-1]
        use = as_stored(_read_given_mask(photo.mask, displayed, photo.camera), header.orientation)
        valid = use if valid is None else valid & use
    if photo.lens is None:
        pixels = upright(pixels, header.orientation)
        valid = None if valid is None else upright(valid, header.orientation)
    else:
        pixels, valid = _undistort(pixels, valid, photo.lens, photo.camera, header, (width, height))
    pixels, valid = _resize(pixels, width, height), _resize_valid(valid, width, height)
    empty = pixels[..., 3] if pixels.shape[2] == 4 else None
    pixels = np.ascontiguousarray(pixels[..., :3])
    if valid is not None:
        if photo.mask is not None:
            pixels = _filled(pixels, valid, photo.path, masked=True)
        elif not valid.any():
            raise bad_photo(photo.path, "shows nothing: all of it is transparent, or out of its lens's sight")
        elif alpha is not None and not transparent_is_empty:
            pixels = fill(pixels, valid)
    return LoadedPhoto(pixels, valid, empty)


def read_mask(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(H, W) bool: where the mask of a photo is white, resized to the photo's `size` (as displayed) by nearest pixel.

    Transparent pixels are not white: many programs save selections so. Where the file is a photo with its background
    cut out, its transparency is the mask. Raises BadInput like `read_pixels`, and for a mask that is grey or coloured.
    """
    return cv2.resize(_white_in(path), size, interpolation=cv2.INTER_NEAREST_EXACT) > 0


def _read_given_mask(mask: GivenMask, size: tuple[int, int], camera: Camera) -> np.ndarray:
    """As `read_mask`, of the photo that `camera` took.
    A mask with a lens is undistorted as the photo was, and all is used beyond its edges."""
    if mask.lens is None:
        return read_mask(mask.path, size)
    found, seen = distortion.undistort(255 * _white_in(mask.path)[..., None], mask.lens, camera.resized(*size))
    return (found[..., 0] >= 128) | ~seen


def _white_in(path: Path) -> np.ndarray:
    """(h, w) uint8, at the size of the file and as displayed: 1 where the mask is white, 0 elsewhere."""
    with _called_a_mask():
        header, pixels, alpha = read_stored(path)
    shade = pixels[..., 0].astype(np.uint16) + pixels[..., 1] + pixels[..., 2]
    shade = 255 * shade if shade.max() == 3 else shade  # 0 and 1 are black and white in many programs that make masks
    grey = ((shade > 3 * GREY[0]) & (shade < 3 * GREY[1]) & (True if alpha is None else alpha > 0)).mean()
    if grey > MOST_GREY:
        if alpha is None or not alpha.min() < 128 <= alpha.max():
            raise BadInput(f"The mask {path} is none: {grey:.0%} of its pixels are neither black nor white.", MEANING)
        shade[:] = 3 * 255  # a cut-out
    shade = shade if alpha is None else shade * (alpha / 255)
    return upright((shade >= 3 * 128).astype(np.uint8), header.orientation)


def mask_size(path: Path) -> tuple[int, int]:
    """The size of a mask as displayed. Raises BadInput like `read_pixels`."""
    with _called_a_mask():
        return probe(path).displayed


@contextmanager
def _called_a_mask() -> Iterator[None]:
    try:
        yield
    except BadInput as problem:
        raise BadInput(f"The mask {problem.what}", problem.fix) from None


def _filled(pixels: np.ndarray, use: np.ndarray, path: Path, masked: bool) -> np.ndarray:
    if use.mean() < LEAST_USE:
        if not masked:
            raise bad_photo(path, f"shows something in {use.mean():.1%} of its pixels: the others are transparent")
        raise BadInput(f"{path} is left with {use.mean():.1%} of its pixels by its mask.", MEANING)
    return fill(pixels, use)


def _over_white(pixels: np.ndarray, alpha: np.ndarray | None) -> np.ndarray:
    if alpha is None:
        return pixels
    share = alpha[..., None].astype(np.float32) / 255
    return np.rint(pixels * share + 255 * (1 - share)).astype(np.uint8)


def off_white(pixels: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """The inverse of `_over_white`: the colours (H, W, 3) uint8 that with this `alpha`, (H, W) uint8, look like
    `pixels` over white; arbitrary where alpha is 0."""
    share = np.maximum(alpha, 1)[..., None].astype(np.float32) / 255
    return np.rint(255 - (255 - pixels) / share).clip(0, 255).astype(np.uint8)


def _undistort(
    pixels: np.ndarray, valid: np.ndarray | None, lens: Lens, camera: Camera, header: Header, wanted: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Stored pixels -> the pinhole picture that `camera` sees, as displayed,
    at up to OVERSAMPLING times the size `wanted`, and where it is valid."""
    channels, layers = pixels.shape[2], [pixels] if valid is None else [pixels, valid * np.uint8(255)]
    most = tuple(OVERSAMPLING * side for side in (wanted[::-1] if swaps_sides(header.orientation) else wanted))
    if pixels.shape[1] > most[0] and pixels.shape[0] > most[1]:
        layers = [_resize(layer, *most) for layer in layers]  # one by one: OpenCV averages over four channels at most
    pixels = np.dstack(layers)
    if lens.orientation == 1:  # the lens is that of the picture as displayed
        pixels = upright(pixels, header.orientation)
    height, width = pixels.shape[:2]
    if swaps_sides(lens.orientation):
        width, height = height, width
    found, seen = distortion.undistort(pixels, lens, camera.resized(width, height))
    if valid is not None:
        seen &= found[..., channels] == 255
    return found[..., :channels], seen


def _resize(pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    if pixels.shape[:2] == (height, width):
        return np.ascontiguousarray(pixels)
    shrinks = pixels.shape[0] >= height and pixels.shape[1] >= width
    return cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)


def _resize_valid(valid: np.ndarray | None, width: int, height: int) -> np.ndarray | None:
    """A pixel is valid if all pixels averaged into it are."""
    if valid is None or valid.all():
        return None
    return _resize(valid * np.uint8(255), width, height) >= 254
