"""L_regM, L_regSH and L_regTS, which hold masks open, residuals small and passers-by transparent
(paper, eqs. 21, 13 and 22).

Unlike the paper's, the first two are means; L_regTS spares Gaussians that are not at the front.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from core.rasterizer.view import CENTRE, CENTRE_REST, FOCAL_X, LEFT, WIDTH

SMOOTH = 1e-8  # under the root, so that a zero residual has a gradient
HIDDEN = 0.5  # a mask below this hides a place: the paper's epsilon, for which it gives no value
# Contribution to some pixel; a Gaussian that reaches less may be the place behind a passer-by, which must stay.
AT_FRONT = 0.1


def mask_regulariser(mask: Float[Tensor, "1 h w"]) -> Float[Tensor, ""]:
    """L_regM: the mean of (1 - M)^2."""
    return ((1 - mask) ** 2).mean()


def residual_norm(residual: Float[Tensor, "v c 3"]) -> Float[Tensor, ""]:
    """L_regSH: the mean over Gaussians of |residual|; a sum would drown out the picture loss. 0 without Gaussians."""
    if not len(residual):
        return residual.sum()
    return torch.sqrt((residual**2).flatten(1).sum(dim=1) + SMOOTH).mean()


class ResidualLoss(NamedTuple):
    """loss: weight * L_regSH. gradient: dL/d(residual), None without a residual.
    size: mean absolute residual, 0 without Gaussians.

    The gradient depends on nothing else in a step, so it is computed with the loss, before the picture's.
    """

    loss: Float[Tensor, ""]
    gradient: Float[Tensor, "v c 3"] | None
    size: Float[Tensor, ""]


def residual_loss(residual: Float[Tensor, "v c 3"], weight: float, shown: Int[Tensor, ""] | None) -> ResidualLoss:
    """L_regSH at this weight. shown: on a GPU, how many of the first rows are Gaussians,
    the rest being padding; None for all."""
    if residual.dtype == torch.float32 and residual.device.type == "cuda":
        from core.training.losses import residual_cuda  # Triton, which is there with a GPU only

        return residual_cuda.residual_loss(residual, weight, shown)
    return plain_residual_loss(residual, weight)


def plain_residual_loss(residual: Float[Tensor, "v c 3"], weight: float) -> ResidualLoss:
    """`residual_loss` in plain torch: what the kernel has to equal."""
    leaf = residual.detach().requires_grad_()
    loss = weight * residual_norm(leaf)
    loss.backward()
    size = leaf.detach().abs()
    return ResidualLoss(loss.detach(), leaf.grad, size.mean() if len(leaf) else size.sum())


def transient_rows(
    means: Float[Tensor, "v 3"],
    contributions: Float[Tensor, " v"],
    mask: Float[Tensor, "1 h w"],
    view: Float[Tensor, "25"],
) -> Bool[Tensor, " v"]:
    """Which Gaussians L_regTS makes transparent: those whose centre projects to a mask below HIDDEN, and that
    contribute more than AT_FRONT to some pixel. contributions: see `Rasterizer.contributions`. view: the camera, see
    core.rasterizer.view.
    """
    axes, centre = view[:CENTRE].view(3, 3), view[CENTRE:CENTRE_REST]
    fx, fy, cx, cy = view[FOCAL_X:LEFT]
    width, height = view[WIDTH:]
    x, y, depth = ((means.detach().double() - centre) @ axis for axis in axes)
    safe = torch.where(depth.abs() > 1e-12, depth, 1e-12)
    x, y = fx * x / safe + cx, fy * y / safe + cy  # as `Camera.project`
    h, w = mask.shape[-2:]
    columns: Int[Tensor, " v"] = (x * w / width).floor().clamp(-1, w).long()
    rows: Int[Tensor, " v"] = (y * h / height).floor().clamp(-1, h).long()
    inside = (columns >= 0) & (columns < w) & (rows >= 0) & (rows < h) & (depth > 0)
    hidden = mask.detach()[0, rows.clamp(0, h - 1), columns.clamp(0, w - 1)] < HIDDEN
    return inside & hidden & (contributions > AT_FRONT)
