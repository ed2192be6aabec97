"""What is evaluated: anything that embeds pictures and renders looks. The protocols need nothing else."""

from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from core.appearance.refinement import Refinable
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
