"""The reference against closed forms, hand arithmetic and finite differences."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from core.rasterizer import create
from core.rasterizer.contract import (
    ALPHA_MAX,
    ALPHA_MIN,
    BLUR_PX2,
    JACOBIAN_MARGIN,
    LOG_SCALE_RANGE,
    NEAR,
    STOP_TRANSMITTANCE,
)
from core.rasterizer.reference import blend_weights, coverage, project
from core.scene.camera import Camera
from core.scene.harmonics import SH_0, SH_1, colour
from core.scene.splats import Splats
from tests.rasterizer.scenes import BACKGROUND, SCENES, camera, cloud, double, in_world
from tests.rasterizer.tolerances import EXACT


def draw(splats: Splats, view: Camera) -> torch.Tensor:
    return create("reference").render(splats, view, BACKGROUND)


def single(view: Camera, local, log_scales, opacity: float, quaternion=(1.0, 0.0, 0.0, 0.0)) -> Splats:
    """One splat in float64; `local` is its mean in camera axes."""
    logit = math.log(opacity / (1 - opacity))
    return in_world(view, [local], [quaternion], [log_scales], [logit], [[[0.7, 0.0, -0.3]]], torch.float64)


def pixel_grid(view: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    y, x = torch.meshgrid(torch.arange(view.height).double(), torch.arange(view.width).double(), indexing="ij")
    return x + 0.5, y + 0.5


# ------------------------------------------------------------------------------------------------------- closed forms


def test_one_round_splat_is_a_gaussian_over_the_background():
    view = camera(21, 15, focal=30.0, turned=False)
    splats = single(view, [0.05, -0.1, 2.0], [math.log(0.2)] * 3, 0.8)
    # J at a slope that is not zero stretches the splat: J J' = (f / z)^2 (I + s s'), s the slope.
    slope = torch.tensor([0.025, -0.05], dtype=torch.float64)
    covariance = (30.0 * 0.2 / 2.0) ** 2 * (torch.eye(2) + torch.outer(slope, slope)) + BLUR_PX2 * torch.eye(2).double()
    x, y = pixel_grid(view)
    offset = torch.stack([x - (view.cx + 30 * 0.025), y - (view.cy - 30 * 0.05)], dim=-1)
    power = torch.einsum("hwi,ij,hwj->hw", offset, torch.linalg.inv(covariance), offset)
    alpha = 0.8 * torch.exp(-power / 2)
    alpha = torch.where(alpha >= ALPHA_MIN, alpha, 0)[:, :, None]
    colours = SH_0 * splats.sh[0, 0] + 0.5
    expected = alpha * colours + (1 - alpha) * torch.tensor(BACKGROUND, dtype=torch.float64)
    torch.testing.assert_close(draw(splats, view), expected, rtol=0, atol=EXACT)
    assert 0 < (alpha == 0).sum() < alpha.numel()


def test_a_long_splat_lies_along_its_axis():
    """Turned by 30 degrees about the viewing axis: variances 3^2 and 1 px^2 along (cos, sin) and across."""
    view = camera(20, 20, focal=20.0, turned=False)
    turn = math.radians(30)
    quaternion = (math.cos(turn / 2), 0, 0, math.sin(turn / 2))
    splats = single(view, [0, 0, 2.0], np.log([0.3, 0.1, 0.05]), 0.9, quaternion)
    along = np.array([math.cos(turn), math.sin(turn)])
    across = np.array([-along[1], along[0]])
    covariance = 9 * np.outer(along, along) + np.outer(across, across) + BLUR_PX2 * np.eye(2)
    inverse = np.linalg.inv(covariance)
    conic = project(splats, view).conics[0].numpy()
    np.testing.assert_allclose(conic, [inverse[0, 0], inverse[0, 1], inverse[1, 1]], rtol=EXACT)


def test_projected_covariance_is_that_of_a_linearised_camera():
    """Against finite differences of Camera.project, which shares no code with the rasterizer."""
    view = camera(fx=37.0, fy=52.0)
    splats = double(cloud(view, 12, seed=1, spread=0.8))
    projection = project(splats, view)
    quaternions = splats.quaternions / splats.quaternions.norm(dim=1, keepdim=True)
    for row in range(12):
        mean = splats.means[row].numpy()
        step = 1e-5  # error of a central difference: step^2 relative
        ends = np.concatenate([mean + step * np.eye(3), mean - step * np.eye(3)])
        pixels, _ = view.project(ends)
        slope = (pixels[:3] - pixels[3:]).T / (2 * step)
        w, x, y, z = quaternions[row].tolist()
        # Rodrigues: R = I + 2 w K + 2 K K with K the cross product matrix of (x, y, z).
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        axes = (np.eye(3) + 2 * w * cross + 2 * cross @ cross) @ np.diag(np.exp(splats.log_scales[row].numpy()))
        covariance = slope @ axes @ axes.T @ slope.T + BLUR_PX2 * np.eye(2)
        inverse = np.linalg.inv(covariance)
        expected = np.array([inverse[0, 0], inverse[0, 1], inverse[1, 1]])
        np.testing.assert_allclose(projection.conics[row].numpy(), expected, rtol=1e-6, atol=1e-6 * inverse.max())
        np.testing.assert_allclose(projection.centres[row].numpy(), view.project(mean[None])[0][0], rtol=EXACT)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("side", [-1, 1])
def test_jacobian_is_clamped_beside_the_picture(axis, side):
    """Beyond the margin a footprint no longer changes with the mean's slope; inside it does."""
    view = camera(turned=False)
    size, middle = (view.width, view.height)[axis], (view.cx, view.cy)[axis]
    limit = ((1 + JACOBIAN_MARGIN) * size - middle if side > 0 else -JACOBIAN_MARGIN * size - middle) / view.fx

    def conic(slope: float) -> torch.Tensor:
        local = [0.2, 0.2, 2.0]
        local[axis] = slope * 2
        return project(single(view, local, [-1.0, -2.0, -1.5], 0.5), view).conics[0]

    torch.testing.assert_close(conic(limit + side * 1e-9), conic(limit + side * 5), rtol=EXACT, atol=0)
    assert (conic(limit - side * 1e-2) - conic(limit)).abs().max() > 1e-6


def test_colour_is_seen_along_the_ray_from_the_camera():
    """Band 1 shows -y, z, -x of the direction: from camera to mean, not the other way, and in world axes."""
    view = camera()
    splats = single(view, [0, 0, 2.0], [3.0] * 3, 0.5)
    forward = view.world_to_camera[2]
    splats.sh = torch.tensor([[[0.0] * 3, [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]], dtype=torch.float64)
    row, column = int(view.cy), int(view.cx)
    alpha = create("reference").contributions(splats, replace(view, cx=column + 0.5, cy=row + 0.5)).item()
    image = create("reference").render(splats, replace(view, cx=column + 0.5, cy=row + 0.5))[row, column]
    expected = alpha * (0.5 + 0.1 * SH_1 * np.array([-forward[1], forward[2], -forward[0]]))
    np.testing.assert_allclose(image.numpy(), expected, rtol=0, atol=EXACT)


def test_probe_moves_the_centres():
    """By whole pixels: the picture moves along."""
    view = camera()
    splats = double(cloud(view, 10, seed=4, spread=0.3))
    probe = torch.tensor([[3.0, -2.0]], dtype=torch.float64).expand(10, 2)
    moved = create("reference").render(splats, view, BACKGROUND, probe)
    torch.testing.assert_close(moved[:-2, 3:], draw(splats, view)[2:, :-3], rtol=0, atol=EXACT)


def test_conics_of_needles_survive_float32():
    """Row 1 of the extreme cases: a*c - b*b in float32 is wrong by over 1 % for a sixth of such needles."""
    view = camera(640, 480, focal=600.0)
    splats = cloud(view, 20_000, seed=2, degree=0, sizes_px=(1.0, 500.0))
    splats.log_scales[:, 1:] -= torch.linspace(0, math.log(1e6), 20_000)[:, None]
    single_precision, judge = project(splats, view), project(double(splats), view)
    traces = judge.conics[:, 0] + judge.conics[:, 2]
    error = (single_precision.conics - judge.conics).abs().amax(dim=1) / traces
    assert error.max() < 1e-3  # the direction of a 1:1000 needle, rounded by 1e-7, turns its small entry by 1e-4
    assert error.median() < 1e-6


def test_blend_is_the_loop_of_the_original_rasterizer():
    """The dense products against the loop as renderCUDA writes it, with its early stop, on thick and thin stacks."""
    random = torch.Generator().manual_seed(3)
    pixels = torch.rand(40, 2, generator=random, dtype=torch.float64) * 6
    centres = torch.rand(30, 2, generator=random, dtype=torch.float64) * 6
    conics = torch.tensor([0.3, 0.1, 0.2], dtype=torch.float64).expand(30, 3)
    opacities = torch.rand(30, generator=random, dtype=torch.float64)
    opacities[20:] = 0.9999
    weights, transmittances = blend_weights(pixels, centres, conics, opacities)
    raw = coverage(pixels, centres, conics, opacities).tolist()
    stopped = 0
    for pixel in range(40):
        left, expected = 1.0, [0.0] * 30
        for splat in range(30):
            alpha = min(ALPHA_MAX, raw[pixel][splat])
            if alpha < ALPHA_MIN:
                continue
            if left * (1 - alpha) < STOP_TRANSMITTANCE:
                stopped += 1
                break
            expected[splat] = alpha * left
            left *= 1 - alpha
        np.testing.assert_allclose(weights[pixel].numpy(), expected, rtol=0, atol=EXACT)
        assert abs(transmittances[pixel].item() - left) < EXACT
    assert 0 < stopped < 40


def test_weights_and_what_is_left_sum_to_one():
    """White splats over white are white: no light is lost or made, whatever is skipped, clamped or stopped."""
    for name in ("random_degree_3", "opaque_stack", "three_thousand_on_one_pixel", "needles"):
        scene = SCENES[name]()
        splats = double(scene.splats)
        white = splats.with_sh(torch.full_like(splats.sh[:, :1], 0.5 / SH_0))
        image = create("reference").render(white, scene.camera, (1.0, 1.0, 1.0))
        torch.testing.assert_close(image, torch.ones_like(image), rtol=0, atol=1e-10)  # 3,000 additions


def test_equal_depths_are_drawn_by_index():
    view = camera(5, 5, turned=False, cx=2.5, cy=2.5)
    splats = double(
        in_world(view, [[0, 0, 2.0]] * 2, [[1, 0, 0, 0]] * 2, [[0.0] * 3] * 2, [0.0] * 2, np.zeros((2, 1, 3)))
    )
    splats.sh[0, 0], splats.sh[1, 0] = 1.0, -1.0
    middle = create("reference").render(splats, view)[2, 2, 0].item()
    first, second = 0.5 + SH_0, 0.5 - SH_0
    assert abs(middle - (0.5 * first + 0.25 * second)) < EXACT


def test_contributions_are_the_largest_weights():
    view = camera(5, 5, turned=False, cx=2.5, cy=2.5)
    local = [[0, 0, 3.0], [0, 0, 2.0], [0, 0, -1.0]]
    splats = double(in_world(view, local, [[1, 0, 0, 0]] * 3, [[2.0] * 3] * 3, [0.0] * 3, np.zeros((3, 1, 3))))
    splats.logit_opacities[1] = math.log(0.25 / 0.75)
    contributions = create("reference").contributions(splats, view)
    assert contributions.tolist() == pytest.approx([0.375, 0.25, 0.0], abs=EXACT)


def test_visible_ends_where_the_ellipse_leaves_the_picture():
    view = camera(20, 10, focal=20.0, turned=False)
    opacity, deviation = 0.5, math.sqrt(BLUR_PX2)  # a point: only the blur is left of its covariance
    reach = deviation * math.sqrt(2 * math.log(opacity / ALPHA_MIN))
    for beyond, expected in ((-1e-3, [0]), (1e-3, [])):
        u = -reach - beyond
        splats = single(view, [(u - view.cx) / view.fx * 2, 0.0, 2.0], [-19.0] * 3, opacity)
        assert create("reference").visible(splats, view).rows.tolist() == expected


@pytest.mark.parametrize("depth, expected", [(NEAR * 1.001, [0]), (NEAR, []), (0.0, []), (-1.0, [])])
def test_near_plane(depth, expected):
    view = camera(turned=False)
    assert create("reference").visible(single(view, [0, 0, depth], [-8.0] * 3, 0.5), view).rows.tolist() == expected


# ---------------------------------------------------------------------------------------------------------- gradients


def smooth_scene(degree: int, count: int) -> tuple[Splats, Camera]:
    """Few wide splats, so that every alpha in every pixel is between the thresholds and the picture has no kinks."""
    view = camera(4, 3, focal=8.0)
    splats = cloud(view, count, seed=5, degree=degree, sizes_px=(4.0, 6.0), ratio=1.5, opacities=(0.3, 0.7), spread=0.6)
    projection = project(double(splats), view)
    x, y = pixel_grid(view)
    pixels = torch.stack([x.flatten(), y.flatten()], dim=1)
    alphas = coverage(pixels, projection.centres, projection.conics, projection.opacities)
    assert 2 * ALPHA_MIN < alphas.min() and alphas.max() < 0.9
    return double(splats), view


@pytest.mark.parametrize("degree, count", [(0, 4), (3, 2)])
def test_gradients_are_those_of_finite_differences(degree, count):
    splats, view = smooth_scene(degree, count)

    def picture(probe, *tensors):
        return create("reference").render(Splats(*tensors), view, BACKGROUND, probe)

    inputs = [torch.zeros(count, 2, dtype=torch.float64), *splats.tensors().values()]
    # Central differences of 1e-6 in float64 are good to about 1e-9.
    assert torch.autograd.gradcheck(picture, [tensor.requires_grad_() for tensor in inputs], atol=1e-6, rtol=1e-5)


def test_projection_gradients_beside_the_picture():
    """Where the Jacobian is clamped, the slope in it is a constant but the centre still moves."""
    view = camera()
    splats = double(cloud(view, 8, seed=6, spread=5.0))

    def stage(means, quaternions, log_scales):
        moved = replace(splats, means=means, quaternions=quaternions, log_scales=log_scales)
        projection = project(moved, view)
        return projection.centres, projection.conics, projection.directions

    inputs = [splats.means, splats.quaternions, splats.log_scales]
    assert torch.autograd.gradcheck(stage, [tensor.requires_grad_() for tensor in inputs], atol=1e-6, rtol=1e-5)


def test_every_stage_passes_gradcheck():
    """Projection in the picture, colour, coverage and blending, each on its own."""
    view = camera()
    splats = double(cloud(view, 6, seed=16, degree=3, spread=0.6))

    def projected(means, quaternions, log_scales, logit_opacities):
        seen = project(Splats(means, quaternions, log_scales, logit_opacities, splats.sh), view)
        return seen.centres, seen.conics, seen.variances, seen.directions, seen.opacities

    geometry = [tensor.requires_grad_() for name, tensor in splats.tensors().items() if name != "sh"]
    seen = project(splats.detached(), view)
    pixels = seen.centres[:3] + torch.tensor([0.4, -0.3])
    flat, bright = [seen.centres, seen.conics, seen.opacities], splats.sh + torch.eye(16, 3)
    assert torch.autograd.gradcheck(projected, geometry, atol=1e-6, rtol=1e-5)
    for stage, inputs in (
        (colour, [bright, seen.directions]),  # away from the clamp at black
        (lambda *values: coverage(pixels, *values), flat),
        (lambda *values: blend_weights(pixels, *values), flat),
    ):
        assert torch.autograd.gradcheck(
            stage, [tensor.clone().requires_grad_() for tensor in inputs], atol=1e-6, rtol=1e-5
        )


def test_clamped_alpha_has_no_gradient():
    view = camera(1, 1, turned=False, cx=0.5, cy=0.5)
    splats = single(view, [0, 0, 2.0], [3.0] * 3, 0.999).map(lambda tensor: tensor.requires_grad_())
    create("reference").render(splats, view).sum().backward()
    assert splats.logit_opacities.grad.item() == 0
    assert splats.sh.grad[0, 0, 0].item() == pytest.approx(ALPHA_MAX * SH_0, abs=EXACT)


def test_log_scales_outside_their_range_have_no_gradient():
    view = camera()
    low, high = LOG_SCALE_RANGE
    splats = single(view, [0.05, 0.02, 2.0], [low - 5, high + 2, -3.0], 0.5, (0.9, 0.2, 0.3, 0.1))
    splats = splats.map(lambda tensor: tensor.requires_grad_())
    draw(splats, view).square().sum().backward()
    assert splats.log_scales.grad[0, :2].tolist() == [0, 0]
    assert splats.log_scales.grad[0, 2] != 0
    at_the_limits = single(view, [0.05, 0.02, 2.0], [low, high, -3.0], 0.5, (0.9, 0.2, 0.3, 0.1))
    assert torch.equal(draw(splats, view), draw(at_the_limits, view))
