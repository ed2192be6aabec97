"""The known truth about the photos of a synthetic scene: clean renders and masks, in SCENE/truth/."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from core.data.photos.names import relative_path
from core.data.photos.pixels import read_pixels
from core.errors import BadInput

FOLDER = "truth"


@dataclass(frozen=True)
class Truth:
    """clean: the photo without passers-by, in the photo's own light, [0, 1]. static: False where passers-by stand."""

    clean: Float[Tensor, "h w 3"] | None = None
    static: Bool[Tensor, "h w"] | None = None

    def to(self, device: torch.device) -> "Truth":
        """The same on `device`."""
        return Truth(*(None if part is None else part.to(device) for part in (self.clean, self.static)))


UNKNOWN = Truth()


def load_truth(scene: Path, photo_name: str, width: int, height: int) -> Truth:
    """The truth of a photo at a picture size (px): truth/clean/NAME.png and truth/masks/NAME.png (white = static).

    NAME is the photo's name without its suffix. scene: its folder. Parts without a file are None.
    Raises BadInput for a file that cannot be read.
    """
    name = relative_path(photo_name).with_suffix(".png")
    clean = _read(scene / FOLDER / "clean" / name, width, height)
    masks = _read(scene / FOLDER / "masks" / name, width, height)
    return Truth(
        None if clean is None else torch.from_numpy(clean).float() / 255,
        None if masks is None else torch.from_numpy(masks[..., 0] >= 128),
    )


def _read(path: Path, width: int, height: int) -> np.ndarray | None:
    if not path.is_file():
        return None
    try:
        pixels = read_pixels(path)
    except BadInput as problem:
        raise BadInput(problem.what, f"Restore it, or remove the folder {FOLDER}.") from None
    if pixels.shape[:2] != (height, width):
        pixels = cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA)
    return pixels
