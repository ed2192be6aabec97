"""When the GPU's memory runs out in the middle of training: what was learned is saved, and the user is told what to lower."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from core.errors import LESS_MEMORY, TrainingStopped, command
from core.training.trainer import Trainer


@contextmanager
def saved_if_memory_runs_out(trainer: Trainer) -> Iterator[None]:
    """Around training: where torch gets no memory on the GPU, a checkpoint is written and TrainingStopped raised."""
    try:
        yield
    except torch.OutOfMemoryError:
        path = trainer.save()  # moves tensor by tensor to the machine's own memory: takes none on the GPU
        bake = command("wegs", "bake", "--run", trainer.folder, "--appearance", "PHOTO", "-o", "look.ply")
        raise TrainingStopped(
            f"The memory of the GPU ran out at step {trainer.done}, with {len(trainer.gaussians)} Gaussians. Saved {path}.",
            f"{LESS_MEMORY}; what is saved can be baked: {bake}",
        ) from None
