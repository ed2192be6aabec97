"""The backends as tests hold them: every one takes CPU tensors, and is skipped by name where this machine lacks what it needs."""

import pytest
import torch
from torch import Tensor

from core.errors import BadSetting
from core.rasterizer import BACKENDS, ON_GPU, Rasterizer, Visible, create
from core.rasterizer.shares import Shares
from core.scene.camera import Camera
from core.scene.splats import Splats

EVERY_BACKEND = list(BACKENDS)
FAST_BACKENDS = [name for name in BACKENDS if name != "reference"]
# What Triton's interpreter takes half a minute and more for: 3 ms a splat and tile. On a GPU all scenes are drawn.
TOO_LARGE = {"three_thousand_on_one_pixel", "many_tiles"}


class OnGpu:
    """A backend of the GPU that moves what it gets there, and what it makes back."""

    def __init__(self, rasterizer: Rasterizer):
        self.rasterizer, self.name = rasterizer, rasterizer.name

    def visible(self, splats: Splats, camera: Camera) -> Visible:
        return Visible(self.rasterizer.visible(moved(splats), camera).rows.cpu())

    def render(self, splats: Splats, camera: Camera, background=(0.0, 0.0, 0.0), probe: Tensor | None = None) -> Tensor:
        probe = None if probe is None else probe.cuda()
        return self.rasterizer.render(moved(splats), camera, background, probe).cpu()

    def contributions(self, splats: Splats, camera: Camera) -> Tensor:
        return self.rasterizer.contributions(moved(splats), camera).cpu()

    def shares(self, splats: Splats, camera: Camera, weight: Tensor) -> Shares:
        shares = self.rasterizer.shares(moved(splats), camera, weight.cuda())
        return Shares(shares.cells.cpu(), shares.gaussians.cpu(), shares.values.cpu(), shares.size)


def moved(splats: Splats) -> Splats:
    return splats.map(torch.Tensor.cuda)


def is_interpreted(name: str) -> bool:
    """Whether the backend `name` runs by Triton's interpreter here, a thousand times slower than on a GPU."""
    return name in ON_GPU and not torch.cuda.is_available()


def backend_or_skip(name: str, scene: str | None = None) -> Rasterizer:
    """The backend `name`, or a skip that says what this machine lacks; scene: of SCENES, that is to be drawn with it."""
    try:
        backend = create(name, "cuda" if name in ON_GPU and not is_interpreted(name) else "cpu")
    except BadSetting as missing:
        pytest.skip(str(missing))
    if is_interpreted(name) and scene in TOO_LARGE:
        pytest.skip(f"{scene} is too large for Triton's interpreter; it is drawn where there is a GPU.")
    return backend if is_interpreted(name) or name not in ON_GPU else OnGpu(backend)
