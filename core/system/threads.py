"""Work in blocks, or one piece beside another, on a few Python threads: without OpenMP, whose threads wait by spinning.

On a machine that does something else as well, a spinning thread keeps the one it waits for from running: a step of the
SH transfer on two OpenMP threads that share one core takes ten times as long as on one thread. Blocks are cut by size,
never by the number of threads, so results do not depend on it.

What is too small or too serial to be cut runs `beside` other work. A thread that is busy with such a piece joins the
blocks when it is done; nobody waits for it to begin.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from typing import TypeVar

import torch

from core.system.cores import cores

Item = TypeVar("Item")
Result = TypeVar("Result")


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Keep torch from starting OpenMP threads from this thread; the number is restored at the end of the block."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def threads_for_blocks() -> Iterator[None]:
    """As `one_torch_thread`, but `in_parallel` and `beside` go on using as many threads as torch had. A decorator too.

    For work in which torch's own operations are small: OpenMP's threads save less than they cost where ours are at
    work.
    """
    before, _calling_thread.threads = _calling_thread.threads, threads()
    try:
        with one_torch_thread():
            yield
    finally:
        _calling_thread.threads = before


class _CallingThread(threading.local):
    """The number of threads for blocks of the calling thread, where it differs from torch's."""

    threads: int | None = None


_calling_thread = _CallingThread()


def threads() -> int:
    """How many threads `in_parallel` and `beside` use:
    torch's number, or the one it had before `threads_for_blocks`."""
    return torch.get_num_threads() if _calling_thread.threads is None else _calling_thread.threads


def in_parallel(work: Callable[[int, int], None], total: int, block: int, most: int | None = None) -> None:
    """Call work(begin, end) for each block of range(total), the last one perhaps shorter, in any order; wait for all.

    On `threads()` threads, or `most` if that is fewer, each with one torch thread and without gradients. Kernels
    release the interpreter lock. After an exception in `work`, or Ctrl-C, no further block is begun, and it is raised
    here once all threads have stopped.
    """
    starts = iter(range(0, total, block))  # next() on it is atomic under the interpreter lock
    extra = min(threads(), most or threads(), -(-total // block)) - 1

    def take_turns() -> None:
        torch.set_num_threads(1)  # belongs to the thread that sets it, and so does no_grad
        with torch.no_grad():
            try:
                for begin in starts:
                    work(begin, min(begin + block, total))
            except BaseException:
                for _ in starts:  # so that the other threads find no block either
                    pass
                raise

    with one_torch_thread():
        others = [_pool().submit(take_turns) for _ in range(extra)]
        try:
            take_turns()
        finally:
            # A thread that is still busy with other work would find no block left: only those that have begun are
            # awaited.
            came = [other for other in others if not other.cancel()]
            wait(came)
    for other in came:
        other.result()


def mapped_in_parallel(work: Callable[[Item], Result], items: Sequence[Item], most: int | None = None) -> list[Result]:
    """[work(item) for item in items], each item a block of `in_parallel`."""
    results: dict[int, Result] = {}

    def one(number: int, _: int) -> None:
        results[number] = work(items[number])

    in_parallel(one, len(items), 1, most)
    return [results[number] for number in range(len(items))]


def beside(work: Callable[[], Result]) -> Callable[[], Result]:
    """Start work() on another thread; calling what is returned gives its result, or raises its exception.

    With one torch thread, and with gradients if the caller has them. If there is no other thread, or it has not begun
    by the time the result is asked for, the caller does the work then. So the work must not depend on what the caller
    does in the meantime.
    """
    with_gradients = torch.is_grad_enabled()

    def there() -> Result:
        torch.set_num_threads(1)
        with torch.set_grad_enabled(with_gradients):
            return work()

    if threads() == 1:
        return work
    other = _pool().submit(there)

    def finish() -> Result:
        if not other.cancel():
            return other.result()
        with one_torch_thread():
            return work()

    return finish


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(1, cores() - 1), thread_name_prefix="wegs")
