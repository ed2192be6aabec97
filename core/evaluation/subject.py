"""What is evaluated: something that embeds pictures and renders looks. Protocols know no more of it."""

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
        """What is static in a picture (1) and what is not (0), of any size, or None without a network that says so."""

    def seen_by(self, camera: Camera) -> Render:
        """What renders its view in any look; differentiable in the tone, and in the embedding if looks follow it at all."""

    def bound(self, embedding: Float[Tensor, " e"]) -> Float[Tensor, " e"]:
        """The embedding, or the nearest to it that a refinement may take."""
