"""StepContexts, as losses are asked for them."""

from core.rasterizer import BLACK
from core.training.step_context import StepContext
from core.training.trainer import Trainer


def context_at(trainer: Trainer, progress: float, done: int = 0) -> StepContext:
    """A step of the first photo at its full size.
    progress, done: see StepContext; here neither follows from the other."""
    return StepContext(index=0, done=done, progress=progress, camera=trainer.photos[0].camera, background=BLACK)
