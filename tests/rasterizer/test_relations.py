"""Relations that every picture must keep, whatever is in it, in every backend."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from core.rasterizer import BACKENDS, Rasterizer, create, reference
from core.scene.camera import Camera
from core.scene.splats import Splats
from tests.rasterizer.backends import backend_or_skip
from tests.rasterizer.scenes import BACKGROUND, SCENES, TURN, camera, cloud, double, poisoned
from tests.rasterizer.tolerances import EXACT, FLIPPED_PIXEL, FLIPPED_SHARE, PICTURE


@dataclass(frozen=True)
class Backend:
    """A rasterizer in the precision it is for: the reference in float64, all others in float32."""

    rasterizer: Rasterizer
    dtype: torch.dtype

    def draw(self, splats: Splats, view: Camera) -> torch.Tensor:
        return self.rasterizer.render(splats.map(lambda tensor: tensor.to(self.dtype)), view, BACKGROUND)

    def assert_same(self, picture: torch.Tensor, other: torch.Tensor, exact: float = EXACT) -> None:
        """Equal within `exact` in float64; in float32 as two backends are, pixels at a threshold apart."""
        if self.dtype == torch.float64:
            torch.testing.assert_close(picture, other, rtol=0, atol=exact)
            return
        error = (picture - other).abs().amax(dim=2)
        assert (error > PICTURE).double().mean() <= FLIPPED_SHARE and error.max() <= FLIPPED_PIXEL


@pytest.fixture(params=BACKENDS)
def backend(request) -> Backend:
    return Backend(backend_or_skip(request.param), torch.float64 if request.param == "reference" else torch.float32)


def test_poison_leaves_the_neighbours_alone(backend):
    """The picture and the gradients are bit for bit those of the scene without the poisoned Gaussians."""
    scene = poisoned()
    tensors = scene.splats.tensors().values()
    healthy = torch.stack([tensor.reshape(len(tensor), -1).isfinite().all(dim=1) for tensor in tensors]).all(dim=0)
    assert 0 < healthy.sum() < len(healthy)
    assert healthy[backend.rasterizer.visible(scene.splats, scene.camera).rows].all()
    results = []
    for splats in (scene.splats, scene.splats[healthy]):
        splats = splats.map(lambda tensor: tensor.clone().requires_grad_())
        image = backend.draw(splats, scene.camera)
        results.append((image, torch.autograd.grad(image.square().sum(), list(splats.tensors().values()))))
    assert torch.equal(results[0][0], results[1][0])
    for with_poison, without in zip(results[0][1], results[1][1]):
        assert torch.equal(with_poison[healthy], without)
        assert (with_poison[~healthy] == 0).all()


@pytest.mark.parametrize("factor", [0.1, 37.0, 1e3])
def test_scaling_the_world_changes_nothing(backend, factor):
    view = camera()
    splats = double(cloud(view, 40, seed=7, degree=3))
    larger = replace(splats, means=splats.means * factor, log_scales=splats.log_scales + math.log(factor))
    scaled = backend.draw(larger, replace(view, centre=view.centre * factor))
    backend.assert_same(scaled, backend.draw(splats, view), 1e-11)  # conics are scaled up and down again


def test_moving_the_world_with_the_camera_changes_nothing(backend):
    """Rotated with colours that are alike from all sides (SH rotate with the world); shifted with all bands."""
    view = camera()
    splats = double(cloud(view, 40, seed=8, degree=3))
    # 700 rounded at 1e-13, times f / sigma; in float32, 7 units cost as much.
    shift = torch.tensor([3.0, -700.0 if backend.dtype == torch.float64 else -7.0, 12.5], dtype=torch.float64)
    moved = replace(splats, means=splats.means + shift)
    shifted = backend.draw(moved, replace(view, centre=view.centre + shift.numpy()))
    backend.assert_same(shifted, backend.draw(splats, view), 1e-9)

    plain = splats.with_sh(splats.sh[:, :1])
    # TURN as a quaternion, from its trace; then R(turn * q) = TURN R(q).
    w = math.sqrt(1 + np.trace(TURN)) / 2
    x, y, z = [(TURN[i, j] - TURN[j, i]) / (4 * w) for i, j in ((2, 1), (0, 2), (1, 0))]
    left = torch.tensor([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]], dtype=torch.float64)
    turned = replace(plain, means=plain.means @ torch.from_numpy(TURN).T, quaternions=plain.quaternions @ left.T)
    around = replace(view, world_to_camera=view.world_to_camera @ TURN.T, centre=TURN @ view.centre)
    backend.assert_same(backend.draw(turned, around), backend.draw(plain, view), 1e-11)


def test_a_permutation_changes_nothing(backend):
    view = camera()
    splats = cloud(view, 40, seed=9)
    shuffled = splats[torch.randperm(40)]
    assert torch.equal(backend.draw(shuffled, view), backend.draw(splats, view))


def test_a_permutation_of_equal_depths_changes_the_order_and_nothing_else(backend):
    """The picture is that of the permuted list: first come, first drawn."""
    scene = SCENES["equal_depths"]()
    backwards = scene.splats[torch.arange(len(scene.splats) - 1, -1, -1)]
    picture, other = (backend.draw(splats, scene.camera) for splats in (scene.splats, backwards))
    assert (picture - other).abs().max() > 0.01
    apart = backwards.map(torch.clone)
    apart.means[:, 2] += 1e-4 * torch.arange(len(apart))  # depths that say what the order of the list said
    assert (backend.draw(apart, scene.camera) - other).abs().max() < 0.02  # moved by up to 0.1 px


def test_a_crop_is_a_window_of_the_picture(backend):
    """Of splats near the middle: the Jacobian's clamp follows the picture, so a crop changes what is beside it."""
    view = camera()
    splats = double(cloud(view, 40, seed=10, spread=0.5))
    window = view.cropped(10, 7, 26, 19)
    backend.assert_same(backend.draw(splats, window), backend.draw(splats, view)[7:26, 10:36])


def test_invisible_gaussians_change_nothing(backend):
    view = camera()
    splats = cloud(view, 30, seed=11)
    faint = cloud(view, 10, seed=12, opacities=(0.001, 0.003))
    behind = cloud(view, 10, seed=13, depths=(-3.0, -1.0))
    with_them = Splats.concatenate([faint, splats, behind])
    assert torch.equal(backend.draw(with_them, view), backend.draw(splats, view))


def test_chunks_change_nothing(monkeypatch):
    scene = SCENES["picture_15x15"]()
    pictures = []
    for chunk in (reference.CHUNK, 1000, 1):
        monkeypatch.setattr(reference, "CHUNK", chunk)
        splats = double(scene.splats).map(lambda tensor: tensor.requires_grad_())
        image = create("reference").render(splats, scene.camera, BACKGROUND)
        image.square().sum().backward()
        pictures.append((image.detach(), splats.means.grad, create("reference").contributions(splats, scene.camera)))
    for image, gradient, contributions in pictures[1:]:
        torch.testing.assert_close(image, pictures[0][0], rtol=0, atol=EXACT)
        torch.testing.assert_close(gradient, pictures[0][1], rtol=1e-9, atol=1e-9)  # sums over 225 pixels, regrouped
        torch.testing.assert_close(contributions, pictures[0][2], rtol=0, atol=EXACT)


def test_far_from_the_origin_float32_is_as_good_as_at_it(backend):
    """The same picture, to float32's rounding, as with everything shifted to the origin in float64 first."""
    scene = SCENES["far_from_the_origin"]()
    near = replace(scene.splats, means=(scene.splats.means.double() - torch.from_numpy(scene.camera.centre)).float())
    single = replace(backend, dtype=torch.float32)
    at_origin = single.draw(near, replace(scene.camera, centre=np.zeros(3)))
    torch.testing.assert_close(single.draw(scene.splats, scene.camera), at_origin, rtol=0, atol=1e-5)
