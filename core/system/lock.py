"""A folder held by one process at a time, by flock(2): nothing is left on disk, and a killed process lets go of it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


@contextmanager
def taken(folder: Path) -> Iterator[bool | None]:
    """True if the folder is ours within the block, so that no other process can take it. False if another process holds it, or held and removed
    it. None if the system or the disk has no such locks."""
    if fcntl is None:
        yield None
        return
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except FileNotFoundError:
        yield False
        return
    try:
        yield _lock(descriptor) and _is_there(folder, descriptor)
    finally:
        os.close(descriptor)


def _is_there(folder: Path, descriptor: int) -> bool:
    """Whether `folder` is still the one that was opened: a lock on one that is gone keeps nobody out."""
    with suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(descriptor), os.stat(folder))
    return False


def _lock(descriptor: int) -> bool | None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True
