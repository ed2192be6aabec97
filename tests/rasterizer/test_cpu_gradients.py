"""The kernels' derivatives against central differences, stage by stage, in float64 where the kernels allow it."""

import numpy as np
import pytest
import torch

from core.rasterizer.cpu import backend, harmonics, project, project_backward
from core.rasterizer.cpu.view import View
from core.rasterizer.layout import SLOT_COLUMNS, SUM_G, SUM_GE, SUM_GEE, SUM_GEY, SUM_GY, SUM_GYY
from core.scene.harmonics import basis as torch_basis
from tests.afresh import afresh
from tests.rasterizer.scenes import camera, in_world

ellipse, ellipse_backward = afresh(project.ellipse), afresh(project_backward.ellipse_backward)
fill_basis, direction_gradient = afresh(harmonics.fill_basis), afresh(harmonics.direction_gradient)

STEP = 1e-6  # of numbers of order 1: truncation 1e-12, rounding 1e-16 / 1e-6
ERROR = 1e-7  # what those leave, with a margin for curvature


def differences(function, at):
    """The gradient of `function` at an array by central differences."""
    gradient = np.zeros_like(at)
    for index in np.ndindex(at.shape):
        moved = [at.copy(), at.copy()]
        moved[0][index] -= STEP
        moved[1][index] += STEP
        gradient[index] = (function(moved[1]) - function(moved[0])) / (2 * STEP)
    return gradient


@pytest.mark.parametrize("beside", [0.0, 3.0], ids=["in the picture", "where the Jacobian is clamped"])
def test_the_gradient_of_the_ellipse_is_that_of_finite_differences(beside):
    """L = sum_p g_p log(alpha_p) over random pixels p: its gradients by offset, quaternion, log scales and centre."""
    random = np.random.default_rng(3)
    view = View.of(camera(fx=35.0, fy=50.0))
    seen = view.rotation, view.lens, view.limits
    offset = view.rotation.T @ np.array([beside + 0.2, -0.1 - beside, 2.0])
    quaternion, log_scales = random.normal(size=(1, 4)), random.normal(-1.5, 0.5, (1, 3))
    pixels, weights = random.uniform(0, 40, (2, 20)), random.normal(size=20)

    def moments(offset, quaternion, log_scales):
        x, y, _, b, c, determinant = ellipse(0, tuple(offset), quaternion, log_scales, *seen)
        dy = pixels[1] - y
        return pixels[0] - x - b / c * dy, dy, c, determinant

    def loss(offset, quaternion, log_scales):
        e, dy, c, determinant = moments(offset, quaternion, log_scales)
        return -0.5 * np.sum(weights * (c / determinant * e**2 + dy**2 / c))

    e, dy, _, _ = moments(offset, quaternion, log_scales)
    sums = np.zeros(SLOT_COLUMNS)
    for column, terms in ((SUM_G, 1), (SUM_GE, e), (SUM_GEE, e**2), (SUM_GY, dy), (SUM_GEY, e * dy), (SUM_GYY, dy**2)):
        sums[column] = np.sum(weights * terms)
    to_quaternion, to_log_scales, to_probe = np.zeros((1, 4)), np.zeros((1, 3)), np.zeros((1, 2))
    to_offset = ellipse_backward(
        0, tuple(offset), quaternion, log_scales, *seen, sums, to_quaternion, to_log_scales, to_probe
    )
    pairs = [
        (to_offset, differences(lambda moved: loss(moved, quaternion, log_scales), offset)),
        (to_quaternion, differences(lambda moved: loss(offset, moved, log_scales), quaternion)),
        (to_log_scales, differences(lambda moved: loss(offset, quaternion, moved), log_scales)),
    ]
    for gradient, expected in pairs:
        scale = np.abs(expected).max()
        assert scale > 1e-2
        np.testing.assert_allclose(gradient, expected, rtol=0, atol=ERROR * scale)


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_harmonics(coefficients):
    random = np.random.default_rng(coefficients)
    direction = random.normal(size=3)
    direction /= np.linalg.norm(direction)
    basis, to_basis = np.full(16, np.nan), random.normal(size=16)

    def evaluated(direction):
        fill_basis(basis, tuple(direction), coefficients)
        return basis[:coefficients].copy()

    degree = int(np.sqrt(coefficients)) - 1
    np.testing.assert_allclose(
        evaluated(direction), torch_basis(torch.from_numpy(direction)[None], degree)[0], rtol=1e-14
    )
    assert np.isnan(basis[coefficients:]).all(), "work beyond the degree"
    expected = differences(lambda moved: evaluated(moved) @ to_basis[:coefficients], direction)
    gradient = direction_gradient(to_basis, tuple(direction), coefficients)
    np.testing.assert_allclose(gradient, expected, rtol=0, atol=ERROR * 10)  # coefficients up to 3, three terms each


def test_the_gradient_of_blending_is_that_of_finite_differences():
    """Colours, opacity and centre through the pixels: the whole backend, in float32, hence coarse steps."""
    view = camera(20, 20)
    # Two splats that cover the picture with alphas away from both thresholds, so that the picture is smooth.
    local, log_scales = np.array([[0.05, 0.0, 2.0], [-0.1, 0.05, 3.0]]), np.log([[0.5, 0.7, 0.6], [0.9, 0.6, 0.5]])
    splats = in_world(
        view, local, [[1, 0.2, 0, 0.1], [0.9, 0, 0.3, 0]], log_scales, [0.0, 1.0], np.full((2, 1, 3), 0.7)
    )
    cotangent = torch.randn(20, 20, 3, generator=torch.Generator().manual_seed(5))
    rasterizer = backend.CpuRasterizer()

    def loss(splats, probe):
        return (rasterizer.render(splats, view, (0.3, 0.1, 0.6), probe).double() * cotangent).sum()

    inputs = splats.tensors() | {"probe": torch.zeros(2, 2)}
    watched = {name: tensor.clone().requires_grad_() for name, tensor in inputs.items()}
    probe = watched.pop("probe")
    loss(type(splats)(**watched), probe).backward()
    gradients = {name: tensor.grad for name, tensor in (watched | {"probe": probe}).items()}
    step = 2e-2  # truncation step^2 = 4e-4; rounding 400 pixels * 1e-7 / step
    for name in ("probe", "logit_opacities", "sh", "log_scales"):
        for index in np.ndindex(*inputs[name].shape):
            sides = []
            for sign in (1, -1):
                moved = {key: tensor.clone() for key, tensor in inputs.items()}
                moved[name][index] += sign * step
                shifted = moved.pop("probe")
                sides.append(loss(type(splats)(**moved), shifted).item())
            expected = (sides[0] - sides[1]) / (2 * step)
            assert gradients[name][index].item() == pytest.approx(
                expected, abs=2e-3 * gradients[name].abs().max().item()
            )
