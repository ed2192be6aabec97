"""One training a run folder: it is taken before the work begins, so that trainings begun together do not share one."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from core.errors import BadInput, not_made
from core.training import run

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


@contextmanager
def new_run(output: Path | None, scene_name: str, force: bool = False) -> Iterator[Path]:
    """The folder that run.choose_folder chooses, made and held; where nothing was put into it, it vanishes again.

    Raises BadInput like run.choose_folder, and for a folder that cannot be made or is held by another training.
    """
    folder, made = _make(output, scene_name, force)
    try:
        with held(folder):
            yield folder
    finally:
        for path in made:
            with suppress(OSError):  # what holds files stays
                path.rmdir()


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Inside, no other process can hold the folder; BadInput if one does. Without a trace on disk, and let go by a kill.

    Where the system or the disk knows no such locks (flock(2)), nothing is held.
    """
    if fcntl is None:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            fix = "Wait until it has ended, or choose another -o."
            raise BadInput(f"Another `wegs train` is at work in {folder}.", fix) from None
        except OSError:
            pass
        yield
    finally:
        os.close(descriptor)


def _make(output: Path | None, scene_name: str, force: bool) -> tuple[Path, list[Path]]:
    """The folder of a new run, and the folders that had to be made for it, innermost first."""
    while True:
        folder = run.choose_folder(output, scene_name, force)
        missing = [path for path in (folder, *folder.parents) if not path.exists()]
        try:
            folder.mkdir(parents=True, exist_ok=output is not None)
            return folder, missing
        except OSError as problem:
            if output is None and isinstance(problem, FileExistsError) and Path(problem.filename) == folder:
                continue  # a training begun at the same time was faster: the next name
            raise not_made(folder, problem) from None
