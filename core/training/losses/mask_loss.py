"""What teaches the mask: a place may be hidden where the photo shows there what the place does not (core.appearance.strangeness)."""

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from core.appearance.strangeness import excess
from core.training.losses.regularisers import mask_regulariser

TYPICAL_ERROR = 0.05  # makes the weight of L_regM comparable with the picture's loss


def cells_of(
    mask: Float[Tensor, "1 h w"], image: Float[Tensor, "H W 3"], photo: Float[Tensor, "3 H W"]
) -> tuple[Float[Tensor, "3 h w"], Float[Tensor, "3 h w"]]:
    """Image and photo averaged down to the mask's cells, detached."""
    pictures = image.detach().permute(2, 0, 1), photo
    return tuple(F.interpolate(each[None], size=mask.shape[-2:], mode="area")[0] for each in pictures)


class CellLoss(nn.Module):
    """The mask may hide a place only where the error there pays for it: see `excess`, of image and photo as `cells_of` gives them.

    A place is best hidden by 1 - M = TYPICAL_ERROR * excess / (2 * regularisation).
    """

    def __init__(self, regularisation: float):
        super().__init__()
        self.regularisation = regularisation

    def forward(self, mask: Float[Tensor, "1 h w"], shown: Float[Tensor, "3 h w"], wanted: Float[Tensor, "3 h w"]) -> tuple[Float[Tensor, ""]]:
        return (TYPICAL_ERROR * (mask * excess(shown, wanted)).mean() + self.regularisation * mask_regulariser(mask),)
