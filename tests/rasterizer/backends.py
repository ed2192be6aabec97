"""The backends as tests hold them: every one takes CPU tensors,
and is skipped by name where this machine lacks what it needs."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from core.errors import BadSetting
from core.rasterizer import BACKENDS, BLACK, ON_GPU, Rasterizer, Visible, create
from core.rasterizer.shares import Shares
from core.scene.camera import Camera
from core.scene.splats import Splats
from tests.rasterizer.scenes import BACKGROUND

FAST_BACKENDS = [name for name in BACKENDS if name != "reference"]
# What Triton's interpreter takes half a minute and more for: 1 ms a splat and tile. On a GPU all scenes are drawn.
TOO_LARGE = {"three_thousand_on_one_pixel", "many_tiles"}


class Moving:
    """A backend for tensors of another device than its own.
    there, back: move a tensor onto its device, and what it makes back."""

    device = "any"

    def __init__(self, rasterizer: Rasterizer, there: Callable[[Tensor], Tensor], back: Callable[[Tensor], Tensor]):
        self.rasterizer, self.name, self.there, self.back = rasterizer, rasterizer.name, there, back

    def visible(self, splats: Splats, camera: Camera) -> Visible:
        return Visible(self.back(self.rasterizer.visible(splats.map(self.there), camera).rows))

    def render(
        self, splats: Splats, camera: Camera, background=BLACK, probe: Tensor | None = None, known=None
    ) -> Tensor:
        probe = None if probe is None else self.there(probe)
        return self.back(self.rasterizer.render(splats.map(self.there), camera, background, probe))

    def contributions(self, splats: Splats, camera: Camera, known=None) -> Tensor:
        return self.back(self.rasterizer.contributions(splats.map(self.there), camera))

    def shares(self, splats: Splats, camera: Camera, weight: Tensor) -> Shares:
        shares = self.rasterizer.shares(splats.map(self.there), camera, self.there(weight))
        return Shares(self.back(shares.cells), self.back(shares.gaussians), self.back(shares.values), shares.shape)


def is_interpreted(name: str) -> bool:
    """Whether the backend `name` runs by Triton's interpreter here, a thousand times slower than on a GPU."""
    return name in ON_GPU and not torch.cuda.is_available()


def device_of(name: str) -> str:
    """Where the backend `name` takes tensors on this machine."""
    return "cuda" if name in ON_GPU and not is_interpreted(name) else "cpu"


def backend_or_skip(name: str, scene: str | None = None) -> Rasterizer:
    """The backend `name`, or a skip that says what this machine lacks; scene:
    of SCENES, that is to be drawn with it."""
    try:
        backend = create(name, device_of(name))
    except BadSetting as missing:
        pytest.skip(str(missing))
    if is_interpreted(name) and scene in TOO_LARGE:
        pytest.skip(f"{scene} is too large for Triton's interpreter; it is drawn where there is a GPU.")
    return backend if device_of(name) == "cpu" else Moving(backend, Tensor.cuda, Tensor.cpu)


def picture_and_gradients(
    rasterizer: Rasterizer, splats: Splats, camera: Camera, probe: Tensor | None = None, known=None
) -> list[Tensor]:
    """The picture, and the gradients of a loss by all parameters and by the probe, if it wants one."""
    splats = splats.map(lambda tensor: tensor.detach().requires_grad_())
    image = rasterizer.render(splats, camera, BACKGROUND, probe, known)
    inputs = [*splats.tensors().values(), *([probe] if probe is not None and probe.requires_grad else [])]
    return [image.detach(), *torch.autograd.grad((image**3).sum(), inputs)]
