"""What is evaluated: something that embeds pictures and renders looks. Protocols know no more of it."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from core.appearance.model import AppearanceModel
from core.rasterizer import BLACK, Colour, Rasterizer
from core.scene.camera import Camera
from core.scene.splats import Splats


@runtime_checkable
class Subject(Protocol):
    """A scene whose look follows an embedding."""

    def embed(self, picture: Float[Tensor, "3 h w"]) -> Float[Tensor, " e"]:
        """The embedding of a picture ([0, 1]) that was not trained on."""

    def mask(self, picture: Float[Tensor, "3 h w"]) -> Float[Tensor, "h4 w4"] | None:
        """What is static in a picture (1) and what is not (0), of any size, or None without a network that says so."""

    def render(self, embedding: Float[Tensor, " e"], camera: Camera) -> Float[Tensor, "H W 3"]:
        """The view in a look; differentiable in the embedding if the look follows it at all."""


@dataclass(frozen=True)
class TrainedScene:
    """Gaussians and their appearance model as a Subject.

    splats: base SH, scene frame. latents: theirs, if any. backdrop: the colour that renders are drawn over.
    """

    splats: Splats
    latents: Float[Tensor, "n l"] | None
    model: AppearanceModel
    rasterizer: Rasterizer
    backdrop: Colour = BLACK

    @torch.no_grad()
    def embed(self, picture: Float[Tensor, "3 h w"]) -> Float[Tensor, " e"]:
        return self.model.look(picture).embedding

    @torch.no_grad()
    def mask(self, picture: Float[Tensor, "3 h w"]) -> Float[Tensor, "h4 w4"] | None:
        mask = self.model.look(picture).mask
        return None if mask is None else mask[0]

    def render(self, embedding: Float[Tensor, " e"], camera: Camera) -> Float[Tensor, "H W 3"]:
        visible = self.rasterizer.visible(self.splats, camera)
        seen = self.splats[visible.rows].detached()
        latents = None if self.latents is None else self.latents[visible.rows].detach()
        sh, _ = self.model.transfer(seen.sh, seen.means, embedding, latents)
        return self.rasterizer.render(seen.with_sh(sh), camera, self.backdrop, pairs=visible.pairs).image
