"""L_regSH on a GPU: core.training.losses.regularisers.residual_loss in one launch and a sum,
where plain torch takes sixteen."""

import torch
import triton
import triton.language as tl
from jaxtyping import Float, Int
from torch import Tensor

from core.kernels.triton_launch import FUSED, blocks
from core.training.losses import regularisers

BLOCK = 16  # Gaussians per program
SMOOTH = tl.constexpr(regularisers.SMOOTH)


@triton.jit(do_not_specialize=["count"])
def weigh_residual(residual, gradient, sums, shown, count, weight, COEFFICIENTS: tl.constexpr, BLOCK: tl.constexpr):
    """The gradient of weight * the mean |residual| over the first `shown` () of `count` rows;
    this loss and the mean absolute number.

    sums: (2, programs), of which each program writes its part of either.
    """
    COLUMNS: tl.constexpr = 3 * COEFFICIENTS
    rows = tl.minimum(tl.load(shown).to(tl.int32), count)
    share = 1.0 / tl.maximum(rows, 1)
    row = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    column = tl.arange(0, triton.next_power_of_2(COLUMNS))
    at = row[:, None] * COLUMNS + column[None, :]
    number = tl.load(residual + at, mask=(row < rows)[:, None] & (column < COLUMNS)[None, :], other=0.0)
    norm = tl.sqrt_rn(tl.sum(number * number, axis=1) + SMOOTH)
    tl.store(
        gradient + at,
        number * (weight * share / norm)[:, None],
        mask=(row < count)[:, None] & (column < COLUMNS)[None, :],
    )
    tl.store(sums + tl.program_id(0), tl.sum(tl.where(row < rows, norm, 0.0), axis=0) * (weight * share))
    tl.store(
        sums + tl.num_programs(0) + tl.program_id(0), tl.sum(tl.sum(tl.abs(number), axis=1), axis=0) * (share / COLUMNS)
    )


def residual_loss(
    residual: Float[Tensor, "v c 3"], weight: float, shown: Int[Tensor, ""] | None = None
) -> regularisers.ResidualLoss:
    """`regularisers.residual_loss` for float32 on a GPU."""
    residual = residual.detach().contiguous()
    count, coefficients = residual.shape[:2]
    if shown is None:
        shown = torch.full((), count, device=residual.device)
    grid, gradient = blocks(count, BLOCK), residual.new_empty(residual.shape)
    sums = residual.new_empty(2, *grid)
    weigh_residual[grid](
        residual, gradient, sums, shown, count, weight, COEFFICIENTS=coefficients, BLOCK=BLOCK, **FUSED
    )
    loss, size = sums.sum(dim=1).unbind()
    return regularisers.ResidualLoss(loss, gradient, size)
