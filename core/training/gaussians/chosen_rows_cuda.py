"""Chosen rows of tensors on a GPU, in one launch for all: core.training.gaussians.chosen_rows.

torch's index_select starts a small program for every row of every tensor, which takes seven times as long as moving the
rows.
"""

import math

import triton
import triton.language as tl
from torch import Tensor

from core.kernels.triton_launch import FUSED, blocks

BLOCK = 1024  # numbers per program, eight per thread


@triton.jit(do_not_specialize=["count"])
def take_rows(sources, copies, rows, count, COLUMNS: tl.constexpr, BLOCK: tl.constexpr):
    """Write `count` rows of each array of `sources`, which has as many COLUMNS, to its place in `copies`,
    zeros for a row of -1; both are tuples.

    A program writes BLOCK numbers of one of them, the first programs those of the first.
    """
    block = tl.program_id(0)
    for array in tl.static_range(len(COLUMNS)):
        size = count * COLUMNS[array]
        if (block >= 0) & (block * BLOCK < size):
            # Or Triton would give each lane four numbers side by side, which the mask lets it move one by one only.
            at = tl.max_contiguous(block * BLOCK + tl.arange(0, BLOCK), 1)
            known = at < size
            row = tl.load(rows + at // COLUMNS[array], mask=known, other=-1)
            number = tl.load(sources[array] + row * COLUMNS[array] + at % COLUMNS[array], mask=row >= 0, other=0.0)
            tl.store(copies[array] + at, number, mask=known)
        block -= tl.cdiv(size, BLOCK)  # counted from the next array's first on


def chosen_rows(tensors: dict[str, Tensor], rows: Tensor) -> dict[str, Tensor]:
    """`core.training.gaussians.chosen_rows.chosen_rows` for float32, contiguous, on a GPU."""
    copies = {name: tensor.new_empty(len(rows), *tensor.shape[1:]) for name, tensor in tensors.items()}
    columns = tuple(math.prod(tensor.shape[1:]) for tensor in tensors.values())
    programs = sum(blocks(copy.numel(), BLOCK)[0] for copy in copies.values())
    take_rows[(programs,)](
        tuple(tensors.values()), tuple(copies.values()), rows, len(rows), COLUMNS=columns, BLOCK=BLOCK, **FUSED
    )
    return copies
