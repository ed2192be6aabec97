"""The mask as the weights of pixels in the picture loss, held up where masks hide too much."""

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

COLLAPSED = 0.6  # mean share of the photos that counts as static; where it is less, masks hide the place itself


def enlarged(mask: Float[Tensor, "1 h w"], height: int, width: int) -> Float[Tensor, "H W"]:
    """The mask at the size of the picture."""
    return F.interpolate(mask[None], size=(height, width), mode="bilinear", align_corners=False)[0, 0]


def pixel_weights(mask: Float[Tensor, "1 h w"], height: int, width: int, mask_mean: float) -> Float[Tensor, "H W"]:
    """The mask as weights of the picture's pixels, detached.

    mask_mean: running mean over photos. Below COLLAPSED the masks are raised until their mean is COLLAPSED again.
    """
    hidden = 1 - enlarged(mask.detach(), height, width)
    if mask_mean < COLLAPSED:
        hidden = hidden * (1 - COLLAPSED) / (1 - mask_mean)
    return 1 - hidden
