"""A photo of a run, at the size that the run uses it at."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from core.appearance.encoder import shrink
from core.automatic import AUTO_PIXELS
from core.config import Settings
from core.data.collection import Photo
from core.data.photos.pixels import load_photo
from core.errors import BadSetting
from core.scene.camera import Camera
from core.setting import UNDECIDED
from core.system.device import CPU

DIVISORS = (1, 2, 4, 8)  # of the original project; any other number is a width
SMALLEST_WIDTH_PX = 64  # below, a width is taken for a mistyped divisor


def check_resolution(resolution: int) -> None:
    """Raise BadSetting for a width in px at which photos show nothing:
    most likely it was meant to divide their size."""
    if resolution not in (UNDECIDED, *DIVISORS) and resolution < SMALLEST_WIDTH_PX:
        raise BadSetting(
            f"resolution={resolution} would make photos {resolution} px wide.",
            f"Type -r 1, 2, 4 or 8 to divide their size, or a width of {SMALLEST_WIDTH_PX} px and more.",
        )


@dataclass(frozen=True)
class Sizes:
    """What sizes the photos of a run are used at. resolution, encoder_side_px: the settings.
    most: pixels of a photo where resolution is auto."""

    resolution: int
    encoder_side_px: int
    most: float = math.inf

    @staticmethod
    def of(settings: Settings, photos: Sequence[Photo]) -> "Sizes":
        """Of all photos of a collection: at -r auto the mean one gets the AUTO_PIXELS of the device. None is enlarged,
        and only the larger ones are shrunk, to the same number of pixels: one huge photo must not take those of all."""
        mean = AUTO_PIXELS["cuda" if settings.device == "cuda" else "cpu"]
        areas = [photo.camera.width * photo.camera.height for photo in photos]
        return Sizes(settings.resolution, settings.encoder_side_px, _ceiling(areas, mean))

    def camera(self, photo: Photo) -> Camera:
        """The camera of a photo at the size that it is trained at."""
        width, height = photo.camera.width, photo.camera.height
        if self.resolution == UNDECIDED:
            factor = max(1.0, math.sqrt(width * height / self.most))
        elif self.resolution in DIVISORS:
            factor = self.resolution
        else:
            factor = max(width / self.resolution, 1)
        return photo.camera.resized(max(1, round(width / factor)), max(1, round(height / factor)))


def _ceiling(numbers: Sequence[int], mean: float) -> float:
    """To what the largest of the numbers have to be lowered for all to have this mean; infinite if theirs is less."""
    left = mean * len(numbers)
    for index, number in enumerate(sorted(numbers)):
        if (share := left / (len(numbers) - index)) <= number:
            return share
        left -= number
    return math.inf


@dataclass(frozen=True)
class SizedPhoto:
    """A photo at the size that it is trained at. camera: at this size. encoder_input: (3, h, w).

    pixels: (H, W, 3) uint8, valid: (H, W) bool or None, and empty: (H, W) uint8 or None are as in
    core.data.photos.pixels.LoadedPhoto.
    """

    photo: Photo
    pixels: np.ndarray
    valid: np.ndarray | None
    camera: Camera
    encoder_input: Tensor
    empty: np.ndarray | None = None

    @property
    def opaque(self) -> np.ndarray | None:
        """(H, W) bool, where the pixels show nothing but the scene; None where all do."""
        if self.empty is None:
            return self.valid
        return (self.empty == 0) & (True if self.valid is None else self.valid)


def load_sized_photo(
    photo: Photo, sizes: Sizes, device: torch.device = CPU, transparent_is_empty: bool = False
) -> SizedPhoto:
    """Decode a photo at the size that it is trained at; BadInput if it is missing or damaged.

    device: of the encoder's input; the pixels stay in the machine's own memory. transparent_is_empty: as `load_photo`
    has it.
    """
    camera = sizes.camera(photo)
    loaded = load_photo(photo, camera.width, camera.height, transparent_is_empty)
    full = torch.from_numpy(loaded.pixels).permute(2, 0, 1).float().div_(255)
    return SizedPhoto(
        photo=photo,
        pixels=loaded.pixels,
        valid=loaded.valid,
        camera=camera,
        encoder_input=shrink(full, sizes.encoder_side_px).to(device),
        empty=loaded.empty,
    )


def as_tensors(
    pixels: np.ndarray, valid: np.ndarray | None, device: torch.device
) -> tuple[Float[Tensor, "h w 3"], Bool[Tensor, "h w"] | None]:
    """The pixels in [0, 1], and where they are valid, on a device."""
    shown = torch.from_numpy(pixels).to(device).float() / 255
    return shown, None if valid is None else torch.from_numpy(valid).to(device)
