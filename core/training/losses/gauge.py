"""What keeps the base harmonics at the neutral look: without it, they and the residual of the mean embedding could drift apart.

Their sum stays the same when one gains what the other loses; choosing one such pair is what physics calls fixing a gauge.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from core.appearance.model import AppearanceModel
from core.system.cuda_graph import Replayed
from core.system.device import sent
from core.training.gaussians.gaussians import Gaussians

ROWS = 1024  # Gaussians drawn each step


class Gauge:
    """The mean, over a draw of Gaussians, of the squared norm of the residual of the mean embedding: 0 where the base is the neutral look.

    Its gradient reaches the networks alone, no other tensor of a step. Zero, without one, if there are no residuals.
    """

    def __init__(self, model: AppearanceModel):
        self.model = model
        self.size = Replayed(ResidualSize(model.sh_transfer)) if model.predicts_residuals else None

    def __call__(self, gaussians: Gaussians, generator: torch.Generator) -> Float[Tensor, ""]:
        if self.size is None or not len(gaussians):
            return torch.zeros((), device=gaussians.counts.device)
        splats, latents = gaussians.splats, gaussians.latents
        rows = sent(torch.randint(len(gaussians), (ROWS,), generator=generator), splats.means.device)
        drawn = [tensor[rows] for tensor in (splats.sh, splats.means, latents) if tensor is not None]
        (size,) = self.size(self.model.mean_embedding, *drawn)
        return size


class ResidualSize(nn.Module):
    """The mean squared norm of the residuals that a transfer adds to some Gaussians."""

    def __init__(self, transfer: nn.Module):
        super().__init__()
        self.transfer = transfer

    def forward(self, embedding: Tensor, sh: Tensor, means: Tensor, latents: Tensor | None = None) -> tuple[Tensor]:
        residual = self.transfer(sh, means, embedding, latents)
        return ((residual**2).sum(dim=(1, 2)).mean(),)
