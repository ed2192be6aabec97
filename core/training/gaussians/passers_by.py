"""Gaussians that stand for passers-by: what masks hide, in few photos.

Masks apply late, when Gaussians have long been trained on everything that photos show. From then on no photo asks for
passers-by, but nothing removes them either, and from elsewhere they stand in the view.
"""

from collections.abc import Iterable

import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from core.rasterizer import Rasterizer
from core.rasterizer.importance import shares_of_picture
from core.scene.camera import Camera
from core.scene.splats import Splats
from core.training.losses.regularisers import HIDDEN

LEAST_HIDDEN = 0.3  # share that masks hide of all that photos show of a passer-by
FEW = 3  # a passer-by stands in one photo, and in another by chance; what more photos hide belongs to the place
SHRUNK = 1 / 2  # photos are rendered at this share of their size


def passers_by(
    splats: Splats, photos: Iterable[tuple[Camera, Float[Tensor, "1 h w"]]], rasterizer: Rasterizer
) -> Bool[Tensor, " n"]:
    """Which Gaussians stand for passers-by. photos: the camera of each, and its mask at any size, 1 = static.

    Fewer than FEW photos hide one: their effective number is (sum x)^2 / sum x^2, x being its share of what the mask
    hides of a photo.
    """
    shown, hidden, squares = splats.means.new_zeros(3, len(splats))
    for camera, mask in photos:
        camera = camera.shrunk(SHRUNK)
        hides = (
            F.interpolate(mask[None], (camera.height, camera.width), mode="bilinear", align_corners=False)[0, 0]
            < HIDDEN
        )
        of_all, of_hidden = shares_of_picture(splats, camera, rasterizer, hides)
        shown += of_all
        hidden += of_hidden
        squares += of_hidden**2
    return (hidden > LEAST_HIDDEN * shown) & (hidden**2 < FEW * squares)
