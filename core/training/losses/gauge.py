"""What keeps the base harmonics at the neutral look: without it, they and the residual of the mean embedding could drift apart.

Their sum stays the same when one gains what the other loses; choosing one such pair is what physics calls fixing a gauge.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from core.appearance.sh_transfer import TransferInput
from core.training.gaussians.gaussians import Gaussians

ROWS = 1024  # Gaussians drawn each step


def draw_rows(gaussians: Gaussians, generator: torch.Generator) -> Int[Tensor, " 1024"]:
    """Which Gaussians to ask in a step."""
    return torch.randint(len(gaussians), (ROWS,), generator=generator)


def gauge(transfer: nn.Module, gaussians: Gaussians, rows: Int[Tensor, " 1024"], neutral: Float[Tensor, " e"]) -> Float[Tensor, ""]:
    """The mean, over a draw of Gaussians, of the squared norm of the residual of the mean embedding: 0 where the base is the neutral look.

    Its gradient reaches the networks alone, no other tensor of a step.
    """
    splats, latents = gaussians.splats, gaussians.latents
    residual = transfer(TransferInput(splats.sh[rows], splats.means[rows], None if latents is None else latents[rows]), neutral)
    return (residual**2).sum(dim=(1, 2)).mean()
