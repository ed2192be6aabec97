"""Adam for Gaussians on a GPU: core.training.adam in one launch a parameter, where plain torch takes twenty."""

from functools import cache

import torch
import triton
import triton.language as tl
from torch import Tensor

from core.training import adam

FUSED = {"enable_fp_fusion": True}  # said in so many words: the default differs between versions of Triton
BLOCK = 256  # numbers a program, two a thread
BETA_1, BETA_2 = tl.constexpr(adam.BETA_1), tl.constexpr(adam.BETA_2)
EPSILON, LARGEST_GRADIENT = tl.constexpr(adam.EPSILON), tl.constexpr(adam.LARGEST_GRADIENT)
UPDATES = tl.constexpr(1 << 15)  # after so many, both corrections are 1 in float32


@triton.jit(do_not_specialize=["size"])
def update(
    values, first, second, counts, corrections, rows, gradient, rates, size, COLUMNS: tl.constexpr, BLOCK: tl.constexpr
):
    """`adam.adam_rows` for arrays of COLUMNS columns. size: of the gradient. corrections: (UPDATES, 2), by number of updates."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    known = at < size
    row = tl.load(rows + at // COLUMNS, mask=known, other=0)
    count = tl.minimum(tl.load(counts + row, mask=known, other=0), UPDATES - 1)
    place = row * COLUMNS + at % COLUMNS
    g = tl.load(gradient + at, mask=known, other=0.0)
    g = tl.minimum(tl.maximum(g, -LARGEST_GRADIENT), LARGEST_GRADIENT)
    m = tl.load(first + place, mask=known, other=0.0) * BETA_1 + g * (1 - BETA_1)
    v = tl.load(second + place, mask=known, other=0.0) * BETA_2 + g * g * (1 - BETA_2)
    tl.store(first + place, m, mask=known)
    tl.store(second + place, v, mask=known)
    unbias_1 = tl.load(corrections + 2 * count, mask=known, other=0.0)
    unbias_2 = tl.load(corrections + 2 * count + 1, mask=known, other=0.0)
    rate = tl.load(rates + at % COLUMNS, mask=known, other=0.0)
    step = rate * m * unbias_1 / (tl.sqrt_rn(v * unbias_2) + EPSILON)
    tl.store(values + place, tl.load(values + place, mask=known, other=0.0) - step, mask=known)


def adam_rows(
    values: Tensor, first: Tensor, second: Tensor, counts: Tensor, rows: Tensor, gradient: Tensor, rates: Tensor
) -> None:
    """As `adam.adam_rows`; contiguous values, first, second, counts and rows, all on one GPU but the rates."""
    # A few numbers: a copy that blocks would wait for every kernel before it.
    rates = rates.to(values.device, non_blocking=True)
    gradient = gradient.contiguous()
    size = gradient.numel()
    update[(triton.cdiv(size, BLOCK),)](
        values, first, second, counts, _corrections(values.device), rows, gradient, rates, size,
        COLUMNS=size // len(rows), BLOCK=BLOCK, **FUSED,
    )  # fmt: skip


@cache
def _corrections(device: torch.device) -> Tensor:
    return torch.from_numpy(adam.corrections(UPDATES.value)).to(device)
