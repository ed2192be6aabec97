"""The mask as the weights of pixels in the picture loss, held up where masks hide too much."""

from jaxtyping import Float
from torch import Tensor

COLLAPSED = 0.6  # mean share of the photos that counts as static; where it is less, masks hide the place itself


def pixel_weights(shown: Float[Tensor, "h w"], mask_mean: Float[Tensor, ""]) -> Float[Tensor, "h w"]:
    """The mask at the size of the picture as weights of its pixels, detached.

    mask_mean: running mean over photos. Below COLLAPSED the masks are raised until their mean is COLLAPSED again.
    """
    return 1 - (1 - shown.detach()) * ((1 - COLLAPSED) / (1 - mask_mean)).clamp(max=1)
