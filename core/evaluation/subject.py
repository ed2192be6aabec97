"""What is evaluated: anything that embeds pictures and renders looks. The protocols know nothing else about it."""

from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from core.appearance.refinement import Render
from core.scene.camera import Camera


@runtime_checkable
class Subject(Protocol):
    """A scene whose look follows an embedding."""

    def embed(self, picture: Float[Tensor, "3 h w"]) -> Float[Tensor, " e"]:
        """The embedding of a picture ([0, 1]) that was not trained on."""

    def mask(self, picture: Float[Tensor, "3 h w"]) -> Float[Tensor, "h4 w4"] | None:
        """The mask of a picture, 1 = static, of any size; None if there is no mask network."""

    def seen_by(self, camera: Camera) -> Render:
        """A function that renders the camera's view in any look; differentiable in the tone, and in the embedding if looks follow it."""

    def sky_in(self, camera: Camera) -> Float[Tensor, "H W"] | None:
        """How much of each pixel of the camera's view is sky, [0, 1]; None if there is none that is told from the place."""

    def bound(self, embedding: Float[Tensor, " e"]) -> Float[Tensor, " e"]:
        """The embedding, or the nearest to it that a refinement may take."""
