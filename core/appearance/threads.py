"""Work on several threads without OpenMP, whose threads wait by spinning.

On a machine that does something else as well, a spinning thread keeps the one it waits for from running: a step of the
SH transfer on two OpenMP threads that share one core takes ten times as long as on one thread.
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


def for_each_block(work: Callable[[slice], None], rows: int, block_rows: int) -> None:
    """Call `work` with the range of each block of `block_rows` rows (the last may be shorter), in any order.

    On as many threads as torch has in the calling thread, each with one torch thread and without gradients. An
    exception in `work` is raised here, after all threads have stopped.
    """
    starts = iter(range(0, rows, block_rows))  # next() on it is atomic under the interpreter lock
    extra = min(torch.get_num_threads(), -(-rows // block_rows)) - 1

    def take_turns() -> None:
        torch.set_num_threads(1)  # belongs to the thread that sets it, and so does no_grad
        with torch.no_grad():
            for start in starts:
                work(slice(start, min(start + block_rows, rows)))

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
    return ThreadPoolExecutor(max(1, (os.cpu_count() or 1) - 1), thread_name_prefix="wegs-appearance")
