"""How much memory this process may take; and a limit on it, held by the system: an allocation beyond fails at once."""

import os
import sys

from core.errors import BadSetting
from core.system import control_groups

GIB = 1 << 30
# Bytes of torch, Numba and others that are mapped from their files: the limit below leaves them out.
LIBRARIES = 300 << 20
# What the program allocates beside the pieces that `fitting` counts. A fifth of it is never touched, but counts too.
OTHER_BYTES = 600 << 20


def hold_to(gib: float) -> None:
    """Limit this process to `gib` GiB of memory from now on.
    An allocation beyond raises MemoryError or, in torch, RuntimeError.

    wegs itself needs 1.2 GiB to start, and 2 GiB to train with torch's CUDA build. The limit (Linux's RLIMIT_DATA,
    getrlimit(2)) counts memory that is allocated, whether or not it is touched, so less is really used.

    Raises BadSetting on other systems, for less than the libraries take, for more than the system can count (most
    likely bytes by mistake), and if a lower limit is already set.
    """
    if not sys.platform.startswith("linux"):
        raise BadSetting(f"--memory {gib}: {sys.platform} cannot limit a process.", "Leave it out.")
    if not LIBRARIES < gib * GIB < sys.maxsize:  # NaN fails it, too
        raise BadSetting(f"--memory {gib} is no number of GiB.", "Type one such as 8.")
    import resource  # Windows has none

    wanted = round(gib * GIB) - LIBRARIES
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if hard != resource.RLIM_INFINITY and wanted > hard:
        raise BadSetting(f"--memory {gib}: this shell allows {hard / GIB:.1f} GiB.", "Lower it, or leave it out.")
    resource.setrlimit(resource.RLIMIT_DATA, (wanted, hard))


def limit() -> int | None:
    """The bytes that this process may allocate, as set by `hold_to` or the shell
    (`ulimit -d`); None without a limit."""
    if not sys.platform.startswith("linux"):
        return None
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_DATA)
    return None if soft == resource.RLIM_INFINITY else soft


def room() -> int | None:
    """The bytes that this process may take: what the machine has, what the container or job allows that it runs in
    (beyond, the system kills it), or the `limit`, whichever is least. None if nothing is known of them."""
    known = [limit(), *control_groups.memory_limits()]
    if "SC_PHYS_PAGES" in getattr(os, "sysconf_names", ()):  # Windows has none
        known.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return min((size for size in known if size is not None), default=None)


def fitting(each: int) -> int:
    """How many pieces of work that take `each` bytes may be at work at once: one, or as many as the `room` holds."""
    whole = room()
    return sys.maxsize if whole is None else max(1, (whole - OTHER_BYTES) // each)
