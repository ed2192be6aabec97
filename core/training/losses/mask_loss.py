"""The loss of the mask: it pays to hide where the photo shows colours that the place does not have
(core.appearance.strangeness)."""

import torch
from jaxtyping import Float
from torch import Tensor

from core.appearance.strangeness import excess
from core.training.losses.photometric import Target
from core.training.losses.regularisers import mask_regulariser

TYPICAL_ERROR = 0.05  # makes the weight of L_regM comparable with the picture's loss


def mask_loss(
    mask: Float[Tensor, "1 h w"], image: Float[Tensor, "H W 3"], target: Target, regularisation: float
) -> Float[Tensor, ""]:
    """mean(TYPICAL_ERROR * M * excess) + regularisation * L_regM,
    where `excess` compares image and photo averaged to the mask's cells.

    It is least where 1 - M = TYPICAL_ERROR * excess / (2 * regularisation). The image gets no gradient.
    """
    image = image.detach()
    if target.valid is not None:  # the target is zero there
        image = torch.where(target.valid[..., None], image, 0)
    shown, wanted = (target.to_cells(planes, *mask.shape[-2:]) for planes in (image.permute(2, 0, 1), target.planes))
    return TYPICAL_ERROR * (mask * excess(shown, wanted)).mean() + regularisation * mask_regulariser(mask)
