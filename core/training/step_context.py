"""A step's place in the run."""

from dataclasses import dataclass

from core.rasterizer import Colour
from core.scene.camera import Camera


@dataclass(frozen=True)
class StepContext:
    """The step on photo `index`, after `done` others.

    progress: of the run, in [0, 1). camera: the photo's, at the picture size of the step. background: of photo and
    render alike.
    """

    index: int
    done: int
    progress: float
    camera: Camera
    background: Colour
