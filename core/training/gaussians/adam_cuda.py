"""Adam for Gaussians on a GPU: core.training.gaussians.adam in one launch a parameter, where plain torch takes twenty."""

from functools import cache

import torch
import triton
import triton.language as tl
from torch import Tensor

from core.kernels.triton_launch import FUSED, blocks
from core.system.device import sent
from core.training.gaussians import adam
from core.training.gaussians.gaussians import Gaussians, free_columns

BLOCK = 256  # numbers a program, two a thread
BETA_1, BETA_2 = tl.constexpr(adam.BETA_1), tl.constexpr(adam.BETA_2)
EPSILON, LARGEST_GRADIENT = tl.constexpr(adam.EPSILON), tl.constexpr(adam.LARGEST_GRADIENT)
UPDATES = tl.constexpr(1 << 15)  # after so many, both corrections are 1 in float32


@triton.jit(do_not_specialize=["size", "solid"])
def update(
    values, first, second, counts, corrections, rows, gradient, rates, taken, size, solid,
    COLUMNS: tl.constexpr, FREE: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """`adam.adam_rows` for an array of COLUMNS columns, if `taken` () is true; the counts come without this update and stay so.

    size: of the gradient. corrections: (UPDATES, 2), by number of updates. From row `solid` on, only the first FREE columns move.
    """
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    known = (at < size) & (tl.load(taken) != 0)
    row = tl.load(rows + at // COLUMNS, mask=known, other=0)
    known = known & ((row < solid) | (at % COLUMNS < FREE))
    count = tl.minimum(tl.load(counts + row, mask=known, other=0), UPDATES - 2) + 1
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


def step(gaussians: Gaussians, rows: Tensor, leaves: dict[str, Tensor], rates: dict[str, Tensor], taken: Tensor) -> None:
    """As `Gaussians.step`; all on one GPU but the rates, which go there in one piece."""
    names = [name for name, leaf in leaves.items() if name in rates and leaf.grad is not None]
    if not (len(rows) and names):
        return  # a view of nothing
    table = sent(torch.cat([rates[name] for name in names]), rows.device).split([len(rates[name]) for name in names])
    for name, name_rates in zip(names, table):
        gradient, columns = leaves[name].grad.contiguous(), len(name_rates)
        size = gradient.numel()
        update[blocks(size, BLOCK)](
            gaussians.parameters[name], gaussians.first[name], gaussians.second[name], gaussians.counts,
            _corrections(rows.device), rows, gradient, name_rates, taken, size, gaussians.solid,
            COLUMNS=columns, FREE=free_columns(name, columns), BLOCK=BLOCK, **FUSED,
        )  # fmt: skip
    gaussians.counts.index_add_(0, rows, taken.int().expand(len(rows)))


@cache
def _corrections(device: torch.device) -> Tensor:
    return torch.from_numpy(adam.corrections(UPDATES.value)).to(device)
