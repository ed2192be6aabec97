"""Where memory or the disk runs out in the middle of training:
what was learned is saved, and the user is told what to do."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from traceback import clear_frames

from core.errors import LESS_MEMORY, DiskFull, TrainingStopped, WegsError, as_disk_full, as_out_of_memory, command
from core.rasterizer.inputs import ListsTooLarge
from core.run.checkpoint import how_to_go_on
from core.training.trainer import Trainer
from core.words import counted


@contextmanager
def saved_if_room_runs_out(trainer: Trainer) -> Iterator[None]:
    """Around training: where it finds no room, a checkpoint is written and TrainingStopped raised;
    other errors of the system are raised on."""
    try:
        yield
    except (DiskFull, OSError) as problem:  # such as of a log that cannot be written
        path = trainer.save()
        if (full := as_disk_full(problem)) is None:
            raise
        raise TrainingStopped(
            f"{full.what} {_kept(trainer, path)}", f"Free some space, then type: {how_to_go_on(trainer.folder)}"
        ) from None
    except Exception as problem:
        if (cause := as_no_room(problem)) is None:
            raise
        clear_frames(problem.__traceback__)  # which hold all that the failed step had made
        path = trainer.save()
        bake = command("wegs", "bake", "--run", trainer.folder, "--appearance", "PHOTO", "-o", "look.ply")
        raise TrainingStopped(
            f"{cause.what} {_kept(trainer, path)}", f"{LESS_MEMORY}; what is saved can be baked: {bake}"
        ) from None


def as_no_room(problem: BaseException) -> WegsError | None:
    """The error to show if `problem` means that there is not enough memory for a picture or a step, else None."""
    return problem if isinstance(problem, ListsTooLarge) else as_out_of_memory(problem)


def _kept(trainer: Trainer, path: Path) -> str:
    return f"Saved at step {trainer.state.done}, with {counted(len(trainer.gaussians), 'Gaussian')}: {path}."
