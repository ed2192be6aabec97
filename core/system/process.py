"""Settings of the whole process, made once before torch is loaded:
how threads wait, how often they switch, and that freed memory is kept; and where it is not to be kept."""

import ctypes
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from core.system.cores import cores, scheduled

# mallopt(3). By default, glibc returns what a training step frees to the system and asks for it again in the next one,
# page by page: 250 to 500 page faults per step, 2% of the time of a training, without a gain in memory.
M_TRIM_THRESHOLD, KEPT_BYTES = -1, 256 << 20  # kept at the end of a heap; from 128 MiB on, a step returns nothing
M_MMAP_THRESHOLD, LARGEST_BLOCK = -3, 32 << 20  # larger blocks always are returned; glibc takes no higher value
APART_BYTES = 128 << 10  # glibc's own value of the second
# How long a thread waits for the interpreter before it asks another to give it up: 5 ms by default, twice what the
# encoder takes beside a step. On two threads a step of 324x210 takes 44.3 ms with 5 ms, 43.8 with 1 ms, 43.1 with 0.2
# ms and 43.4 with 0.05 ms.
SWITCH_S = 2e-4


def prepare() -> None:
    """Set up this process for the engine. OpenMP reads its settings when torch is loaded;
    values that the user has set stay."""
    # Threads that spin while they wait keep the kernels' own from running.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    if (allowed := cores()) < scheduled():  # OpenMP counts these
        os.environ.setdefault("OMP_NUM_THREADS", str(allowed))
    sys.setswitchinterval(SWITCH_S)
    _mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
    _mallopt(M_MMAP_THRESHOLD, LARGEST_BLOCK)


@contextmanager
def blocks_apart() -> Iterator[None]:
    """Until the end of the `with`, a block of APART_BYTES or more lies outside the heap, and is returned when freed.

    For work that leaves a little of the much that it takes, again and again: in the heap, what is left keeps gaps from
    growing together. They are 0.4 MB per photo that is decoded, and count against a limit on memory.
    """
    _mallopt(M_MMAP_THRESHOLD, APART_BYTES)
    try:
        yield
    finally:
        _mallopt(M_MMAP_THRESHOLD, LARGEST_BLOCK)


def return_freed() -> None:
    """Return the pages of all gaps in the heap to the system. They still count against a limit on memory."""
    if trim := _of_glibc("malloc_trim"):
        trim(0)


def _mallopt(parameter: int, value: int) -> None:
    if mallopt := _of_glibc("mallopt"):
        mallopt(parameter, value)


def _of_glibc(name: str) -> Callable[..., int] | None:
    """This function of glibc's; None under musl, which has none of these, and on other systems."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform.startswith("linux") else None
