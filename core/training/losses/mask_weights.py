"""The mask as weights of the pixels in the picture loss, raised if masks hide too much."""

from jaxtyping import Float
from torch import Tensor

LEAST_STATIC = 0.6  # least mean share of the photos that is static; masks that leave less hide the place itself


def pixel_weights(shown: Float[Tensor, "h w"], mask_mean: Float[Tensor, ""]) -> Float[Tensor, "h w"]:
    """The weights (detached) that a mask at the size of the picture gives its pixels.

    mask_mean: running mean over photos. Below LEAST_STATIC the masks are raised until their mean is LEAST_STATIC again.
    """
    return 1 - (1 - shown.detach()) * ((1 - LEAST_STATIC) / (1 - mask_mean)).clamp(max=1)
