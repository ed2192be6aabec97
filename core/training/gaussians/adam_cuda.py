"""Adam for Gaussians on a GPU: core.training.gaussians.adam in one launch for all parameters,
where plain torch takes twenty for each."""

from functools import cache

import torch
import triton
import triton.language as tl
from torch import Tensor

from core.kernels.triton_launch import FUSED, blocks
from core.training.gaussians import adam
from core.training.gaussians.gaussians import Gaussians, free_columns

ROWS = 32  # per program
BLOCK = 256  # numbers that a program updates at a time, one per thread
WARPS = BLOCK // 32
BETA_1, BETA_2 = tl.constexpr(adam.BETA_1), tl.constexpr(adam.BETA_2)
EPSILON, LARGEST_GRADIENT = tl.constexpr(adam.EPSILON), tl.constexpr(adam.LARGEST_GRADIENT)
UPDATES = tl.constexpr(1 << 15)  # after so many, both corrections are 1 in float32


@triton.jit(do_not_specialize=["count", "solid"])
def update(
    values, first, second, gradients, rates, counts, corrections, rows, taken, count, solid,
    COLUMNS: tl.constexpr, FREE: tl.constexpr, ROWS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """`adam.adam_rows` for `count` rows of tuples of arrays but those of -1, if `taken` () is true;
    each program has ROWS of them to itself.

    COLUMNS: of each array. FREE: how many of these move from row `solid` on. rates: those of all arrays, one behind the
    other. corrections: (UPDATES, 2), by number of updates.
    """
    if tl.load(taken) != 0:
        begin = tl.program_id(0) * ROWS
        end = tl.minimum(begin + ROWS, count)
        for array in tl.static_range(len(COLUMNS)):
            block = begin * COLUMNS[array]
            while block < end * COLUMNS[array]:
                at = block + tl.arange(0, BLOCK)
                column = at % COLUMNS[array]
                known = at < end * COLUMNS[array]
                row = tl.load(rows + at // COLUMNS[array], mask=known, other=-1)
                known = (row >= 0) & ((row < solid) | (column < FREE[array]))
                updates = tl.minimum(tl.load(counts + row, mask=known, other=0), UPDATES - 2) + 1
                offset = row * COLUMNS[array] + column
                g = tl.load(gradients[array] + at, mask=known, other=0.0)
                g = tl.minimum(tl.maximum(g, -LARGEST_GRADIENT), LARGEST_GRADIENT)
                m = tl.load(first[array] + offset, mask=known, other=0.0) * BETA_1 + g * (1 - BETA_1)
                v = tl.load(second[array] + offset, mask=known, other=0.0) * BETA_2 + g * g * (1 - BETA_2)
                tl.store(first[array] + offset, m, mask=known)
                tl.store(second[array] + offset, v, mask=known)
                unbias_1 = tl.load(corrections + 2 * updates, mask=known, other=0.0)
                unbias_2 = tl.load(corrections + 2 * updates + 1, mask=known, other=0.0)
                rate = tl.load(rates + column, mask=known, other=0.0)
                step = rate * m * unbias_1 / (tl.sqrt_rn(v * unbias_2) + EPSILON)
                tl.store(
                    values[array] + offset, tl.load(values[array] + offset, mask=known, other=0.0) - step, mask=known
                )
                block += BLOCK
            rates += COLUMNS[array]
        tl.debug_barrier()  # all threads have read the counts
        at = begin + tl.arange(0, ROWS)
        row = tl.load(rows + at, mask=at < end, other=-1)
        tl.store(counts + row, tl.load(counts + row, mask=row >= 0, other=0) + 1, mask=row >= 0)


def step(
    gaussians: Gaussians, rows: Tensor, leaves: dict[str, Tensor], rates: dict[str, Tensor], taken: Tensor
) -> None:
    """As `Gaussians.step`, all on one GPU."""
    gradients = {
        name: leaf.grad.contiguous() for name, leaf in leaves.items() if name in rates and leaf.grad is not None
    }
    if not (len(rows) and gradients):
        return  # a view of nothing
    parameters = [
        tuple(tensors[name] for name in gradients)
        for tensors in (gaussians.parameters, gaussians.first, gaussians.second)
    ]
    columns = tuple(len(rates[name]) for name in gradients)
    update[blocks(len(rows), ROWS)](
        *parameters, tuple(gradients.values()), torch.cat([rates[name] for name in gradients]),
        gaussians.counts, _corrections(rows.device), rows, taken, len(rows), gaussians.solid_count,
        COLUMNS=columns, FREE=tuple(map(free_columns, gradients, columns)),
        ROWS=ROWS, BLOCK=BLOCK, num_warps=WARPS, **FUSED,
    )  # fmt: skip


@cache
def _corrections(device: torch.device) -> Tensor:
    return torch.from_numpy(adam.corrections(UPDATES.value)).to(device)
