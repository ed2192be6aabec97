"""Repeated timings."""

import time
from collections.abc import Callable
from typing import TypeVar

import torch

from core.bench.figure import Spread

LEAST, MOST = 3, 201  # repeats; many for pictures of half a millisecond
Result = TypeVar("Result")


def timed(work: Callable[[], Result], budget: float) -> tuple[Result, Spread]:
    """What `work()` returns, and the seconds it takes: once to warm up (memory is touched), then LEAST to MOST times.

    budget: seconds after which no repeat beyond LEAST is begun. If a single call takes longer than that, there is no
    warm-up: the first time counts, too. So whatever it runs must already be compiled.
    """
    taken: list[float] = []
    warm = False
    while len(taken) < LEAST or (sum(taken) < budget and len(taken) < MOST):
        start = time.perf_counter()
        result = work()
        if torch.cuda.is_initialized():
            torch.cuda.synchronize()  # a GPU is only told what to do
        elapsed = time.perf_counter() - start
        if warm or elapsed > budget:
            taken.append(elapsed)
        warm = True
    return result, Spread.of(taken)
