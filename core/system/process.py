"""What a process is told once, before it loads torch: how its threads wait, and that it keeps memory that was freed."""

import ctypes
import os
import sys

# mallopt(3). By default, glibc returns what a training step frees to the system and asks for it again in the next one, page by page: 250 to
# 500 page faults a step, 2% of the time of a training, without a gain in memory.
M_TRIM_THRESHOLD, KEPT_BYTES = -1, 256 << 20  # kept at the end of a heap; from 128 MiB on, a step returns nothing
M_MMAP_THRESHOLD, LARGEST_BLOCK = -3, 32 << 20  # bytes; larger blocks always are returned, and glibc takes no higher value


def prepare() -> None:
    """Set up this process for the engine. OpenMP reads its setting when torch is loaded; a value of the user's stays."""
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # threads that spin while they wait keep the kernels' own from running
    if sys.platform.startswith("linux"):
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # glibc's; musl has none
        if mallopt is not None:
            mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
            mallopt(M_MMAP_THRESHOLD, LARGEST_BLOCK)
