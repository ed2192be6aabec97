"""One training per run folder, claimed before the work begins, so that trainings begun together do not share one."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from core.errors import BadInput
from core.run import run_folders
from core.system.atomic import made_for_user
from core.system.lock import taken


@contextmanager
def new_run(output: Path | None, scene_name: str, force: bool = False) -> Iterator[Path]:
    """The folder that run_folders.choose_folder chooses, made and held; it is removed again if nothing was put into it.

    Raises BadInput like run_folders.choose_folder, and for a folder that cannot be made or is held by another training.
    """
    with ExitStack() as stack:
        while True:
            folder = run_folders.choose_folder(output, scene_name, force)
            with suppress(FileExistsError):  # a training begun at the same time was faster: the next name
                stack.enter_context(made_for_user(folder, may_exist=output is not None))
                break
        stack.enter_context(held(folder))
        yield folder


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Inside, no other process can hold the folder; BadInput if one does.
    Without locks (core.system.lock) nothing is held."""
    with taken(folder) as ours:
        if ours is False:
            raise BadInput(
                f"Another `wegs train` is at work in {folder}.", "Wait until it has ended, or choose another -o."
            )
        yield
