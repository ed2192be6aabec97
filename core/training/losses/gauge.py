"""The loss that holds the base SH at the neutral look, that of the mean embedding,
by holding the residual of that embedding at zero.

Without it they could drift: what the base gains and all residuals lose changes no picture. Physics calls such a choice
fixing a gauge.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from core.appearance.sh_transfer import TransferInput
from core.training.gaussians.gaussians import Gaussians

ROWS = 1024  # Gaussians sampled in each step


def draw_rows(gaussians: Gaussians, generator: torch.Generator) -> Int[Tensor, " 1024"]:
    """The rows of the Gaussians that a step samples, drawn on the CPU."""
    return torch.randint(len(gaussians), (ROWS,), generator=generator)


def gauge(
    transfer: nn.Module, gaussians: Gaussians, rows: Int[Tensor, " 1024"], neutral: Float[Tensor, " e"]
) -> Float[Tensor, ""]:
    """The mean over the sampled Gaussians of the squared norm of their residual. neutral: the mean embedding.

    Its gradient reaches the networks alone, no other tensor of a step.
    """
    splats, latents = gaussians.splats, gaussians.latents
    residual = transfer(
        TransferInput(splats.sh[rows], splats.means[rows], None if latents is None else latents[rows]), neutral
    )
    return (residual**2).sum(dim=(1, 2)).mean()
