"""What density control gathers, on a GPU: core.training.gaussians.densify.gather in one launch,
where plain torch takes nine."""

import triton
import triton.language as tl
from torch import Tensor

from core.kernels.triton_launch import FUSED, blocks
from core.training.gaussians.gaussians import Gaussians

BLOCK = 128  # Gaussians per program, one per thread


@triton.jit(do_not_specialize=["count"])
def add_view(gradient_sum, seen, rows, probe_gradient, half_size, taken, count, BLOCK: tl.constexpr):
    """`densify.plain_gather` for `count` rows, each there once, but those of -1."""
    if tl.load(taken) != 0:
        at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
        row = tl.load(rows + at, mask=at < count, other=-1)
        known = row >= 0
        x = tl.load(probe_gradient + 2 * at, mask=known, other=0.0) * tl.load(half_size)
        y = tl.load(probe_gradient + 2 * at + 1, mask=known, other=0.0) * tl.load(half_size + 1)
        total = tl.load(gradient_sum + row, mask=known, other=0.0) + tl.sqrt_rn(x * x + y * y)
        tl.store(gradient_sum + row, total, mask=known)
        tl.store(seen + row, tl.load(seen + row, mask=known, other=0.0) + 1.0, mask=known)


def gather(gaussians: Gaussians, rows: Tensor, probe_gradient: Tensor, half_size: Tensor, taken: Tensor) -> None:
    """As `densify.gather`, all on one GPU."""
    add_view[blocks(len(rows), BLOCK)](
        gaussians.gradient_sum, gaussians.seen, rows, probe_gradient.contiguous(), half_size, taken, len(rows),
        BLOCK=BLOCK, **FUSED,
    )  # fmt: skip
