"""A limit on the memory of this process, held by the system: an allocation beyond it fails at once."""

import sys

from core.errors import BadSetting

GIB = 1 << 30
LIBRARIES = 300 << 20  # bytes of torch, Numba and others that are mapped from their files: the limit below leaves them out


def hold_to(gib: float) -> None:
    """Hold this process to `gib` GiB of memory from now on. An allocation beyond raises MemoryError or, in torch, RuntimeError.

    wegs itself needs 1.2 GiB to start, and 2 GiB to train with torch's CUDA build. The limit counts memory that is asked for, whether or not it is
    touched, so less than that is really used. It is Linux's RLIMIT_DATA, see getrlimit(2).

    Raises BadSetting on any other system, for less than the libraries take, for more than the system can count (most likely bytes by mistake), and
    where a lower limit is set already.
    """
    if not sys.platform.startswith("linux"):
        raise BadSetting(f"--memory {gib}: {sys.platform} cannot limit a process.", "Leave it out.")
    if not LIBRARIES < gib * GIB < sys.maxsize:  # nor is NaN
        raise BadSetting(f"--memory {gib} is no number of GiB.", "Type one such as 8.")
    import resource  # Windows has none

    wanted = round(gib * GIB) - LIBRARIES
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if hard != resource.RLIM_INFINITY and wanted > hard:
        raise BadSetting(f"--memory {gib}: this shell allows {hard / GIB:.1f} GiB.", "Lower it, or leave it out.")
    resource.setrlimit(resource.RLIMIT_DATA, (wanted, hard))


def limit() -> int | None:
    """The bytes that this process may take, by `hold_to` or by the shell (`ulimit -d`); None without a limit."""
    if not sys.platform.startswith("linux"):
        return None
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_DATA)
    return None if soft == resource.RLIM_INFINITY else soft
