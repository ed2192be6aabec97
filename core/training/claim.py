"""One training a run folder: it is taken before the work begins, so that trainings begun together do not share one."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from core.errors import BadInput, not_made
from core.lock import taken
from core.training import run


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
    """Inside, no other process can hold the folder; BadInput if one does. Without locks (core.lock) nothing is held."""
    with taken(folder) as ours:
        if ours is False:
            raise BadInput(f"Another `wegs train` is at work in {folder}.", "Wait until it has ended, or choose another -o.")
        yield


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
