"""Every backend against the reference in float64: pictures, gradients and the rest, on every scene."""

from functools import cache

import pytest
import torch

from core.rasterizer.contract import ALPHA_MIN
from core.rasterizer.reference import boxes, project
from tests.rasterizer.backends import FAST_BACKENDS, backend_or_skip, is_interpreted
from tests.rasterizer.scenes import SCENES
from tests.rasterizer.tolerances import (
    FAINT,
    FLIPPED_PIXEL,
    FLIPPED_SHARE,
    FOOTPRINT_PX,
    GRADIENT,
    GRADIENT_OF_ONE,
    GRADIENT_ON_GPU,
    PICTURE,
    Outcome,
    outcome,
    verdict,
)

in_every_scene = pytest.mark.parametrize("name", SCENES)


@pytest.fixture(params=FAST_BACKENDS)
def backend(request):
    """A backend made of kernels, to draw the scene `name` of the test with."""
    return backend_or_skip(request.param, request.node.callspec.params.get("name"))


@cache
def drawn_by(backend: str, scene: str) -> Outcome:
    """All that a backend says about a scene of SCENES; several tests look at it."""
    judge = verdict(SCENES[scene])
    return outcome(backend_or_skip(backend, scene), judge.scene, torch.float32, judge.cotangent)


@in_every_scene
def test_rounding_decides_no_comparison_in_the_scenes(name):
    """Few pixels stand at a threshold, and depths are equal or clearly apart: rounding decides no comparison."""
    judge = verdict(SCENES[name])
    assert (~judge.steady).double().mean() <= FLIPPED_SHARE
    view, means = judge.scene.camera, judge.scene.splats.means.double()
    depths = ((means - torch.from_numpy(view.centre)) @ torch.from_numpy(view.world_to_camera).T)[:, 2]
    gaps = depths[torch.isfinite(depths)].sort().values.diff()
    assert ((gaps < 1e-12) | (gaps > 2e-6)).all()


@in_every_scene
def test_the_picture_is_that_of_the_reference(backend, name):
    judge = verdict(SCENES[name])
    image = backend.render(judge.scene.splats, judge.scene.camera, judge.scene.background)
    error = (image.double() - judge.outcome.image).abs().amax(dim=2)
    assert (error[judge.steady] <= PICTURE).all(), f"off by {error[judge.steady].max():.1e}"
    assert (error <= FLIPPED_PIXEL).all(), f"off by {error.max():.1e} at a threshold"


@in_every_scene
def test_gradients_are_those_of_the_reference(backend, name):
    judge, result = verdict(SCENES[name]), drawn_by(backend.name, name)
    for parameter, expected in judge.outcome.gradients.items():
        gradient = result.gradients[parameter].double()
        assert gradient.shape == expected.shape
        if not len(expected):
            continue
        error, size = [tensor[..., None].abs().flatten(1).amax(dim=1) for tensor in (gradient - expected, expected)]
        most = GRADIENT_ON_GPU if backend.name == "cuda" else GRADIENT
        limit = torch.minimum(most * size.max(), GRADIENT_OF_ONE * (size + FAINT * size.max()))
        assert (error <= limit).all(), f"{parameter}: {(error / limit).max():.1f} times the tolerance"


@in_every_scene
def test_visible_gaussians_are_those_drawn_and_few_others(backend, name):
    judge = verdict(SCENES[name])
    scene, expected = judge.scene, judge.outcome
    rows = drawn_by(backend.name, name).visible
    assert (rows.diff() > 0).all(), "not ascending"
    drawn = torch.nonzero(expected.contributions > 0).squeeze(1)
    assert set(drawn.tolist()) <= set(rows.tolist())
    seen = project(scene.splats[rows].map(torch.Tensor.double), scene.camera)
    low, high = boxes(seen, ALPHA_MIN)
    size = torch.tensor([scene.camera.width, scene.camera.height])
    assert ((high >= -FOOTPRINT_PX) & (low <= size + FOOTPRINT_PX)).all()


@in_every_scene
def test_contributions_are_those_of_the_reference(backend, name):
    judge = verdict(SCENES[name])
    contributions = drawn_by(backend.name, name).contributions.double()
    # A maximum over all pixels may be reached in one at a threshold.
    limit = PICTURE if judge.steady.all() else FLIPPED_PIXEL
    assert contributions.shape == judge.outcome.contributions.shape
    assert ((contributions - judge.outcome.contributions).abs() <= limit).all()


@in_every_scene
def test_what_is_culled_has_no_gradient(backend, name):
    result = drawn_by(backend.name, name)
    culled = torch.ones(len(result.contributions), dtype=torch.bool)
    culled[result.visible] = False
    assert (result.contributions[culled] == 0).all()
    for parameter, gradient in result.gradients.items():
        assert (gradient[culled] == 0).all(), parameter


@pytest.mark.parametrize("name", ["random_degree_3", "three_thousand_on_one_pixel", "wide_splats_beside_the_picture"])
def test_threads_change_nothing(backend, name, on_threads):
    """Bit for bit, pictures and gradients. On a GPU, where threads run in no order at all,
    it is enough to ask again."""
    if is_interpreted(backend.name):
        pytest.skip("Triton's interpreter runs one program after the other.")
    judge = verdict(SCENES[name])
    first, *others = on_threads((1, 2, 3), lambda: outcome(backend, judge.scene, torch.float32, judge.cotangent))
    for other in others:
        assert torch.equal(other.image, first.image)
        assert torch.equal(other.contributions, first.contributions)
        for parameter, gradient in first.gradients.items():
            assert torch.equal(other.gradients[parameter], gradient), parameter
