"""What keeps the base harmonics at the neutral look: without it, they and the residual of the mean embedding could drift apart.

Their sum stays the same when one gains what the other loses; choosing one such pair is what physics calls fixing a gauge.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from core.appearance.model import AppearanceModel
from core.system.device import sent
from core.training.gaussians.gaussians import Gaussians

ROWS = 1024  # Gaussians drawn each step


def gauge(model: AppearanceModel, gaussians: Gaussians, generator: torch.Generator) -> Float[Tensor, ""]:
    """The mean squared residual of the mean embedding, over a draw of Gaussians: 0 where the base is the neutral look.

    Its gradient reaches the networks alone, no other tensor of a step. Zero, without one, if there are no residuals.
    """
    if not (len(gaussians) and model.predicts_residuals):
        return torch.zeros((), device=gaussians.counts.device)
    splats, latents = gaussians.splats, gaussians.latents
    rows = sent(torch.randint(len(gaussians), (ROWS,), generator=generator), splats.means.device)
    latents = None if latents is None else latents[rows]
    _, residual = model.transfer(splats.sh[rows], splats.means[rows], model.mean_embedding, latents)
    return (residual**2).sum(dim=(1, 2)).mean()
