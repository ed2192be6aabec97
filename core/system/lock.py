"""A folder locked by one process at a time, by flock(2): the lock leaves nothing on disk, and ends with the process."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]  # a module that may be missing


@contextmanager
def taken(folder: Path) -> Iterator[bool | None]:
    """Lock `folder` for the block. True if that succeeded; False if another process has locked it, or has locked and
    removed it; None if the system or the disk has no such locks."""
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
    """Whether `folder` is still the one that was opened: a lock on a removed folder keeps nobody out."""
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
