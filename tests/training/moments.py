"""Moments of a run, as losses are asked for them."""

from core.rasterizer import BLACK
from core.training.moment import Moment
from core.training.trainer import Trainer


def moment_at(trainer: Trainer, progress: float, done: int = 0) -> Moment:
    """A step of the first photo at its full size. progress, done: see Moment; here neither follows from the other."""
    return Moment(index=0, done=done, progress=progress, camera=trainer.photos[0].camera, background=BLACK)
