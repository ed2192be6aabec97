"""Settings of the whole process, made once before torch is loaded:
how threads wait, how often they switch, and that freed memory is kept."""

import ctypes
import os
import sys

# mallopt(3). By default, glibc returns what a training step frees to the system and asks for it again in the next one,
# page by page: 250 to 500 page faults per step, 2% of the time of a training, without a gain in memory.
M_TRIM_THRESHOLD, KEPT_BYTES = -1, 256 << 20  # kept at the end of a heap; from 128 MiB on, a step returns nothing
M_MMAP_THRESHOLD, LARGEST_BLOCK = -3, 32 << 20  # larger blocks always are returned; glibc takes no higher value
# How long a thread waits for the interpreter before it asks another to give it up: 5 ms by default, twice what the
# encoder takes beside a step. On two threads a step of 324x210 takes 44.3 ms with 5 ms, 43.8 with 1 ms, 43.1 with 0.2
# ms and 43.4 with 0.05 ms.
SWITCH_S = 2e-4


def prepare() -> None:
    """Set up this process for the engine. OpenMP reads its setting when torch is loaded;
    a value that the user has set stays."""
    # Threads that spin while they wait keep the kernels' own from running.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    sys.setswitchinterval(SWITCH_S)
    if sys.platform.startswith("linux"):
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # glibc's; musl has none
        if mallopt is not None:
            mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
            mallopt(M_MMAP_THRESHOLD, LARGEST_BLOCK)
