"""A photo's view as the trainer has drawn it: what its losses are computed of, and what they lead back to."""

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from core.appearance.model import Look
from core.rasterizer import Visible
from core.scene.camera import Camera
from core.scene.splats import Splats
from core.training.photometric import Target


@dataclass(frozen=True)
class Drawn:
    """One step's view, in the look of its photo.

    target: the photo as it is compared. embedding, leaves, probe: leaves of the graph, those of the look, of the visible Gaussians and
    of their places in the picture (px). seen: those Gaussians in the look. residual: what the look adds to their harmonics.
    regularising: waits for L_regSH of it, see losses.residual_loss.
    """

    camera: Camera
    target: Target
    look: Look
    embedding: Tensor
    visible: Visible
    leaves: dict[str, Tensor]
    seen: Splats
    probe: Tensor
    image: Tensor
    residual: Tensor | None
    regularising: Callable[[], tuple[Tensor, Tensor | None, Tensor]]
    gauge_loss: Tensor
