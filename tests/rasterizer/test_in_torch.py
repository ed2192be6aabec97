"""The backends made of kernels as citizens of torch: autograd, memory layouts, refusals."""

import sys

import pytest
import torch

from core.errors import BadInput
from core.rasterizer import Rasterizer, create
from core.scene.camera import Camera
from core.scene.splats import Splats
from tests.rasterizer.backends import FAST_BACKENDS, backend_or_skip, device_of, picture_and_gradients
from tests.rasterizer.scenes import BACKGROUND, camera, cloud


@pytest.fixture(params=FAST_BACKENDS)
def rasterizer(request) -> Rasterizer:
    """Takes tensors on its own device."""
    backend_or_skip(request.param)
    return create(request.param, device_of(request.param))


@pytest.fixture
def scene(rasterizer) -> tuple[Splats, Camera]:
    """Enough for several blocks of Gaussians and dozens of tiles; little for Triton's interpreter."""
    view, count = (camera(150, 110, focal=120.0), 3000) if rasterizer.name == "cpu" else (camera(20, 17), 12)
    splats = cloud(view, count, seed=50, degree=2, sizes_px=(0.5, 12.0))
    return splats.map(lambda tensor: tensor.to(device_of(rasterizer.name))), view


def test_memory_layout_does_not_matter(rasterizer, scene):
    splats, view = scene
    strided = splats.map(lambda tensor: torch.stack([tensor, tensor + 1], dim=-1)[..., 0])
    assert not strided.sh.is_contiguous()
    results = (picture_and_gradients(rasterizer, each, view) for each in (splats, strided))
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))


def test_inputs_are_not_changed(rasterizer, scene):
    splats, view = scene
    before = splats.map(torch.clone)
    picture_and_gradients(rasterizer, splats, view)
    assert all(torch.equal(a, b) for a, b in zip(before.tensors().values(), splats.tensors().values(), strict=True))


def test_a_single_gradient_can_be_computed_alone_and_twice(rasterizer, scene):
    splats, view = scene
    all_gradients = picture_and_gradients(rasterizer, splats, view)
    coefficients = splats.sh.clone().requires_grad_()
    loss = (rasterizer.render(splats.with_sh(coefficients), view, BACKGROUND) ** 3).sum()
    first, second = (torch.autograd.grad(loss, coefficients, retain_graph=True)[0] for _ in range(2))
    assert torch.equal(first, second)
    assert torch.equal(first, all_gradients[-1])


@pytest.mark.parametrize("name", ["means", "quaternions", "log_scales", "logit_opacities", "sh", "probe"])
def test_other_dtypes_and_devices_are_refused_by_name(rasterizer, scene, name):
    splats, view = scene
    inputs = splats.tensors() | {"probe": torch.zeros(len(splats), 2, device=splats.means.device)}
    right = "float32 on the CPU" if rasterizer.device == "cpu" else "float32 on one GPU"
    for wrong in (inputs[name].double(), inputs[name].to("meta")):
        changed = inputs | {name: wrong}
        probe = changed.pop("probe")
        refused = Splats(**changed)
        with pytest.raises(BadInput, match=f"The {rasterizer.name} rasterizer got {name} as .* Give it {right}"):
            rasterizer.render(refused, view, probe=probe)
        if name != "probe":
            for method in (rasterizer.visible, rasterizer.contributions):
                with pytest.raises(BadInput, match=f"got {name} as"):
                    method(refused, view)


def test_lists_beyond_the_memory_budget_are_refused(rasterizer, scene, monkeypatch):
    splats, view = scene
    monkeypatch.setattr(sys.modules[type(rasterizer).__module__], "BYTES_PER_PAIR", 1 << 40)
    covered = rf"{len(splats)} Gaussians cover \d+ tiles of the {view.width}x{view.height} picture"
    with pytest.raises(BadInput, match=f"{covered}.*--max-gaussians"):
        rasterizer.render(splats, view)
