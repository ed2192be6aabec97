"""What is evaluated: anything that embeds pictures and renders looks. The protocols need nothing else."""

from collections import deque
from collections.abc import Iterator
from typing import Protocol, runtime_checkable

from jaxtyping import Bool, Float
from torch import Tensor

from core.appearance.colouring import Colouring
from core.appearance.refinement import Refinable, Wanted, refinement, steps_of
from core.report import Told, unheard
from core.scene.camera import Camera


@runtime_checkable
class Subject(Protocol):
    """A scene whose look follows a Colouring."""

    @property
    def has_looks(self) -> bool:
        """Whether it has more than one."""

    def embed(self, picture: Float[Tensor, "3 h w"]) -> Float[Tensor, " e"]:
        """The embedding of a picture ([0, 1]) that was not trained on."""

    def mask(self, picture: Float[Tensor, "3 h w"]) -> Float[Tensor, "h4 w4"] | None:
        """The mask of a picture, 1 = static, of any size; None if there is no mask network."""

    def seen_by(self, camera: Camera) -> Refinable:
        """What the camera sees of the scene, in any look."""


def refining_to(
    subject: Subject,
    start: Colouring,
    camera: Camera,
    pixels: Float[Tensor, "h w 3"],
    valid: Bool[Tensor, "h w"] | None,
    told: Told = unheard,
) -> Iterator[Colouring]:
    """The steps of core.appearance.refinement from the look `start` to one in which `camera` sees what a photo shows.

    pixels: the photo, [0, 1]. valid: which pixels count; None: all. told: called with the number of steps done.
    """
    wanted = Wanted.of(camera, pixels, valid)
    seen = subject.seen_by(wanted.camera)
    for step, look in enumerate(refinement(seen, start, wanted)):
        told(step, steps_of(seen))
        yield look


def last(course: Iterator[Colouring]) -> Colouring:
    """The look with which a refinement ends."""
    return deque(course, maxlen=1).pop()
