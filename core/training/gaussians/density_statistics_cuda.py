"""What density control gathers, on a GPU: core.training.gaussians.densify.gather in one launch, where plain torch takes nine."""

import triton
import triton.language as tl
from torch import Tensor

from core.kernels.triton_launch import FUSED, blocks
from core.training.gaussians.gaussians import Gaussians

BLOCK = 128  # Gaussians a program, one a thread


@triton.jit(do_not_specialize=["count"])
def add_view(gradient_sum, seen, rows, probe_gradient, taken, count, half_width, half_height, BLOCK: tl.constexpr):
    """`densify.plain_gather` for `count` rows, each there once. half_width, half_height: of the picture, px."""
    if tl.load(taken) != 0:
        at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
        known = at < count
        row = tl.load(rows + at, mask=known, other=0)
        x = tl.load(probe_gradient + 2 * at, mask=known, other=0.0) * half_width
        y = tl.load(probe_gradient + 2 * at + 1, mask=known, other=0.0) * half_height
        total = tl.load(gradient_sum + row, mask=known, other=0.0) + tl.sqrt_rn(x * x + y * y)
        tl.store(gradient_sum + row, total, mask=known)
        tl.store(seen + row, tl.load(seen + row, mask=known, other=0.0) + 1.0, mask=known)


def gather(gaussians: Gaussians, rows: Tensor, probe_gradient: Tensor, width: int, height: int, taken: Tensor) -> None:
    """As `densify.gather`, all on one GPU."""
    add_view[blocks(len(rows), BLOCK)](
        gaussians.gradient_sum, gaussians.seen, rows, probe_gradient.contiguous(), taken, len(rows), width / 2, height / 2,
        BLOCK=BLOCK, **FUSED,
    )  # fmt: skip
