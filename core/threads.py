"""Work in blocks on a few Python threads, without OpenMP, whose threads wait by spinning.

On a machine that does something else as well, a spinning thread keeps the one it waits for from running: a step of the
SH transfer on two OpenMP threads that share one core takes ten times as long as on one thread. Blocks are cut by size,
never by the number of threads, so results do not depend on it.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache

import torch


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Keep this thread's torch from starting OpenMP threads meanwhile; the number is put back at the end."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def in_parallel(work: Callable[[int, int], None], total: int, block: int) -> None:
    """Call work(begin, end) for each block of range(total), the last maybe shorter, in any order; wait for all.

    On as many threads as torch has in the calling thread, each with one torch thread and without gradients. Kernels release
    the interpreter lock. An exception in `work` is raised here, after all threads have stopped.
    """
    starts = iter(range(0, total, block))  # next() on it is atomic under the interpreter lock
    extra = min(torch.get_num_threads(), -(-total // block)) - 1

    def take_turns() -> None:
        torch.set_num_threads(1)  # belongs to the thread that sets it, and so does no_grad
        with torch.no_grad():
            for begin in starts:
                work(begin, min(begin + block, total))

    with one_torch_thread():
        others = [_pool().submit(take_turns) for _ in range(extra)]
        try:
            take_turns()
        finally:
            wait(others)
    for other in others:
        other.result()


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(1, (os.cpu_count() or 1) - 1), thread_name_prefix="wegs")
