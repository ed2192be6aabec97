"""Which step of a run it is."""

from dataclasses import dataclass

from core.rasterizer import Colour
from core.scene.camera import Camera


@dataclass(frozen=True)
class Moment:
    """A step: of the photo `index`, after `done` others. progress: of the run, in [0, 1). camera: the photo's, at the size of the step.
    background: of its picture.
    """

    index: int
    done: int
    progress: float
    camera: Camera
    background: Colour
