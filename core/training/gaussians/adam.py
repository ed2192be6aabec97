"""Adam for Gaussians: only the rows seen in this step are touched.

A Gaussian outside the view has no gradient; updating it all the same would move it by stale momentum and cost memory
traffic for the whole scene. Each row counts its own updates, so rows born late get the right bias correction. What
begins to learn later than a row's harmonics has no such correction: its first hundred steps are up to six times too
long, which did no harm (core/TRIED.md).
"""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from torch import Tensor

from core.kernels.compiled import exact_kernel
from core.system.threads import in_parallel

BETA_1, BETA_2 = 0.9, 0.999
EPSILON = 1e-15  # 3DGS: gradients of means over pixels are tiny
ROWS_PER_BLOCK = 2048
# Gradients are cut there: the square of one twenty times as large is infinite in float32, and its row would never move
# again.
LARGEST_GRADIENT = 1e18


@exact_kernel
def _count(counts, rows, begin, end):
    for i in range(begin, end):
        counts[rows[i]] += 1


@exact_kernel
def _update(values, first, second, gradient, rates, counts, corrections, rows, begin, end):
    columns = values.shape[1]
    for i in range(begin, end):
        row = rows[i]
        unbias_1, unbias_2 = corrections[counts[row], 0], corrections[counts[row], 1]
        for j in range(columns):
            g = min(max(gradient[i, j], np.float32(-LARGEST_GRADIENT)), np.float32(LARGEST_GRADIENT))
            m = np.float32(BETA_1) * first[row, j] + np.float32(1 - BETA_1) * g
            v = np.float32(BETA_2) * second[row, j] + np.float32(1 - BETA_2) * g * g
            first[row, j] = m
            second[row, j] = v
            values[row, j] -= rates[j] * m * unbias_1 / (np.sqrt(v * unbias_2) + np.float32(EPSILON))


@cache
def corrections(count: int) -> np.ndarray:
    """1 / (1 - beta^t) of both moments for each number t of updates below `count`:
    two powers per row cost more than the rest."""
    powers = np.power([BETA_1, BETA_2], np.arange(1, count)[:, None])
    return np.concatenate([np.ones((1, 2)), 1 / (1 - powers)]).astype(np.float32)


class Moved(NamedTuple):
    """One tensor to be moved. values, first, second: (N, ...) float32 parameters and moments. gradient: (V, ...),
    finite. rates: one learning rate for each element of a row.
    """

    values: Tensor
    first: Tensor
    second: Tensor
    gradient: Tensor
    rates: Tensor


def adam_rows(tensors: Sequence[Moved], counts: Tensor, rows: Tensor) -> None:
    """One Adam step (Kingma & Ba 2015) on some rows of all these, in place; on a CPU.

    counts: (N,) int32 updates of each row, to which this one is added. rows: (V,) int64, each once.
    """
    if not len(rows):
        return  # a view of nothing
    flat = []
    for *arrays, rates in tensors:
        flat.append([*(array.reshape(len(array), -1).numpy() for array in arrays), rates.numpy()])
    table = corrections(1 << (int(counts.max()) + 1).bit_length())  # a power of two, so that few tables are made
    row_counts, row_indices = counts.numpy(), rows.numpy()

    def update(begin: int, end: int) -> None:
        _count(row_counts, row_indices, begin, end)
        for arrays in flat:
            _update(*arrays, row_counts, table, row_indices, begin, end)

    in_parallel(update, len(rows), ROWS_PER_BLOCK)


def plain_adam_rows(tensors: Sequence[Moved], counts: Tensor, rows: Tensor) -> None:
    """The definition of `adam_rows`, on any device."""
    counts[rows] += 1
    for values, first, second, gradient, rates in tensors:
        rates = rates.to(values.device)
        gradient = gradient.clamp(-LARGEST_GRADIENT, LARGEST_GRADIENT)
        m = BETA_1 * first[rows] + (1 - BETA_1) * gradient
        v = BETA_2 * second[rows] + (1 - BETA_2) * gradient**2
        first[rows], second[rows] = m, v
        steps = counts[rows].double().reshape(-1, *[1] * (values.dim() - 1))
        m = m / (1 - BETA_1**steps)
        v = v / (1 - BETA_2**steps)
        values[rows] -= (rates.reshape(values.shape[1:]) * m / (v.sqrt() + EPSILON)).to(values)
