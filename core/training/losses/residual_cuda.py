"""L_regSH on a GPU: core.training.losses.regularisers.residual_loss in one launch and a sum, where plain torch takes sixteen."""

import triton
import triton.language as tl
from jaxtyping import Float
from torch import Tensor

from core.kernels.triton_launch import FUSED, blocks
from core.training.losses import regularisers

BLOCK = 16  # Gaussians a program
SMOOTH = tl.constexpr(regularisers.SMOOTH)


@triton.jit(do_not_specialize=["count"])
def weigh_residual(residual, gradient, sums, count, loss_scale, size_scale, COEFFICIENTS: tl.constexpr, BLOCK: tl.constexpr):
    """The gradient of loss_scale * the sum of |residual| over `count` rows; the loss and size_scale * the sum of all absolute numbers.

    sums: (2, programs), of which each program writes its part of either.
    """
    COLUMNS: tl.constexpr = 3 * COEFFICIENTS
    row = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    column = tl.arange(0, triton.next_power_of_2(COLUMNS))
    known = (row < count)[:, None] & (column < COLUMNS)[None, :]
    at = row[:, None] * COLUMNS + column[None, :]
    number = tl.load(residual + at, mask=known, other=0.0)
    norm = tl.sqrt_rn(tl.sum(number * number, axis=1) + SMOOTH)
    tl.store(gradient + at, number * (loss_scale / norm)[:, None], mask=known)
    tl.store(sums + tl.program_id(0), tl.sum(tl.where(row < count, norm, 0.0), axis=0) * loss_scale)
    tl.store(sums + tl.num_programs(0) + tl.program_id(0), tl.sum(tl.sum(tl.abs(number), axis=1), axis=0) * size_scale)


def residual_loss(residual: Float[Tensor, "v c 3"], weight: float) -> tuple[Float[Tensor, ""], Float[Tensor, "v c 3"], Float[Tensor, ""]]:
    """`regularisers.residual_loss` for float32 on a GPU."""
    residual = residual.detach().contiguous()
    count, coefficients = residual.shape[:2]
    grid, gradient = blocks(count, BLOCK), residual.new_empty(residual.shape)
    sums = residual.new_empty(2, *grid)
    weigh_residual[grid](
        residual, gradient, sums, count, weight / max(count, 1), 1 / max(residual.numel(), 1),
        COEFFICIENTS=coefficients, BLOCK=BLOCK, **FUSED,
    )  # fmt: skip
    loss, size = sums.sum(dim=1).unbind()
    return loss, gradient, size
