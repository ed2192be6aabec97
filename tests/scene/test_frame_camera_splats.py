"""Frames, cameras and splats: what is changed and undone again, and pictures that stay where they were."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from core.errors import BadSetting
from core.scene.camera import Camera
from core.scene.frame import SceneFrame
from core.scene.splats import Splats

TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
CAMERA = Camera(TURN, np.array([0.5, -0.25, 1.0]), 500.0, 480.0, 330.0, 235.0, 640, 480)
FRAME = SceneFrame(np.array([454_000.0, 5_411_000.0, 120.0]), 35.0)  # georeferenced, metres
PIXEL = 1e-6  # float64 rounds a coordinate of 5e6 at 1e-9; times f / z = 500


def points(count: int = 50) -> np.ndarray:
    """World points in front of CAMERA."""
    random = np.random.default_rng(0)
    local = random.uniform([-1, -1, 1], [1, 1, 5], (count, 3))
    return local @ CAMERA.world_to_camera + CAMERA.centre


def splats(count: int = 6) -> Splats:
    return Splats(
        torch.randn(count, 3),
        torch.randn(count, 4),
        torch.randn(count, 3),
        torch.randn(count),
        torch.randn(count, 4, 3),
    )


# -------------------------------------------------------------------------------------------------------------- frame


def test_around_puts_the_quantile_at_radius_one():
    world = np.random.default_rng(1).normal(FRAME.centre, 50.0, (1000, 3))
    world[:10] += 1e5  # outliers, as SfM makes them, move neither centre nor radius by much
    frame = SceneFrame.around(world)
    scene = frame.to_scene(world)
    assert np.mean(np.linalg.norm(scene, axis=1) <= 1) == pytest.approx(0.97, abs=1e-3)
    np.testing.assert_allclose(np.median(scene, axis=0), 0, atol=1e-10)


def test_frame_is_undone():
    world = FRAME.centre + np.random.default_rng(2).normal(0, 50, (20, 3))
    # Half a unit in the last place of 5.4e6 is 5e-10 m.
    np.testing.assert_allclose(FRAME.to_world(FRAME.to_scene(world)), world, rtol=0, atol=1e-8)


def test_to_scene_subtracts_in_float64():
    """A millimetre at 5,411 km is lost in float32, and visible in the scene frame."""
    world = np.stack([FRAME.centre, FRAME.centre + 1e-3])
    assert FRAME.to_scene(world)[1, 1] == pytest.approx(1e-3 / 35, rel=1e-5)


@pytest.mark.parametrize("centre", [(5e6, 5e6, 0), (-5e6, -5e6, 0), (-5e6, -5e6, -5e6), (0, 0, -5e6)])
def test_files_are_moved_wherever_far_from_the_origin_the_world_lies(centre):
    assert SceneFrame(np.array(centre), 1.0).file_offset.tolist() == list(centre)
    assert not SceneFrame(np.array(centre) * 1e-6, 1.0).file_offset.any()
    assert not SceneFrame(np.array(centre), 5e4).file_offset.any()  # far in world units, not in those of the scene


@pytest.mark.parametrize("same", [np.zeros((1, 3)), np.full((7, 3), 4.0)])
def test_around_a_single_place_has_a_radius(same):
    assert SceneFrame.around(same).radius == 1.0


def test_frame_goes_through_json():
    copy = SceneFrame.from_json(json.loads(json.dumps(FRAME.to_json())))
    assert np.array_equal(copy.centre, FRAME.centre) and copy.radius == FRAME.radius


# ------------------------------------------------------------------------------------------------------------- camera


def test_project_is_a_pinhole():
    """Straight ahead falls on the principal point; one unit right and two down at depth 4 by hand."""
    view = replace(CAMERA, world_to_camera=np.eye(3), centre=np.array([1.0, 2.0, 3.0]))
    pixels, depths = view.project(np.array([[1.0, 2.0, 7.0], [2.0, 4.0, 7.0], [1.0, 2.0, -1.0]]))
    assert depths.tolist() == [4, 4, -4]
    assert pixels[0].tolist() == [330, 235]
    assert pixels[1].tolist() == [330 + 500 / 4, 235 + 480 * 2 / 4]


def test_project_at_the_camera_is_finite():
    pixels, depths = CAMERA.project(CAMERA.centre[None])
    assert np.isfinite(pixels).all() and depths[0] == 0


def test_shows_what_lies_before_the_camera_and_inside_its_picture():
    local = np.array([[0, 0, 2], [0, 1.2, 2], [1.3, 0, 2], [0, 0, -2], [0, -1.1, 2], [-1.4, 0, 2]])
    shown, depths = CAMERA.shows(local @ CAMERA.world_to_camera + CAMERA.centre)
    assert shown.tolist() == [True, False, False, False, False, False]
    np.testing.assert_allclose(depths, local[:, 2], rtol=0, atol=1e-12)
    # By at most 10 px, the last one near the camera.
    within = np.array([[0, 1.0, 2], [1.2, 0, 2], [0, -0.95, 2], [-1.3, 0, 2], [0.012, 0, 0.02]])
    assert CAMERA.shows(within @ CAMERA.world_to_camera + CAMERA.centre)[0].all()


def test_resized_moves_every_point_with_the_picture():
    """Pixel centres are at halves: the corners of the picture, not of its pixels, are scaled."""
    before, _ = CAMERA.project(points())
    smaller = CAMERA.resized(320, 160)
    after, _ = smaller.project(points())
    np.testing.assert_allclose(after, before * [320 / 640, 160 / 480], atol=PIXEL)
    assert (smaller.width, smaller.height) == (320, 160)


def test_shrunk_never_enlarges_and_leaves_a_pixel():
    assert CAMERA.shrunk(1.5).numbers() == CAMERA.numbers()
    assert CAMERA.shrunk(0.5).numbers() == CAMERA.resized(CAMERA.width // 2, CAMERA.height // 2).numbers()
    assert (CAMERA.shrunk(1e-4).width, CAMERA.shrunk(1e-4).height) == (1, 1)


def test_cropped_shifts_every_point():
    before, _ = CAMERA.project(points())
    window = CAMERA.cropped(100, 30, 200, 50)
    after, _ = window.project(points())
    np.testing.assert_allclose(after, before - [100, 30], atol=PIXEL)
    assert (window.width, window.height) == (200, 50)


def test_camera_and_points_in_the_scene_show_the_same_picture():
    view = CAMERA.in_world(FRAME)
    world = FRAME.to_world(points())
    in_world, depths = view.project(world)
    in_scene, scene_depths = view.in_scene(FRAME).project(FRAME.to_scene(world))
    np.testing.assert_allclose(in_scene, in_world, atol=PIXEL)
    np.testing.assert_allclose(in_scene, CAMERA.project(points())[0], atol=PIXEL)
    np.testing.assert_allclose(scene_depths * FRAME.radius, depths, atol=1e-7)


# ------------------------------------------------------------------------------------------------------------- splats


def test_rows_and_concatenation_are_inverse():
    whole = splats()
    parts = [whole[:2], whole[torch.tensor([2, 3])], whole[torch.arange(6) >= 4]]
    for joined, tensor in zip(Splats.concatenate(parts).tensors().values(), whole.tensors().values()):
        assert torch.equal(joined, tensor)


def test_splats_in_world_units_are_undone():
    frame = SceneFrame(np.array([100.0, -50.0, 3.0]), 7.0)
    before = splats()
    world = before.in_world(frame)
    # Float32 at 100 units: 4e-6, divided by the radius again.
    torch.testing.assert_close(world.in_scene(frame).means, before.means, rtol=0, atol=2e-6)
    torch.testing.assert_close(world.in_scene(frame).log_scales, before.log_scales, rtol=0, atol=1e-6)
    torch.testing.assert_close(world.log_scales.exp(), before.log_scales.exp() * 7, rtol=1e-5, atol=0)
    torch.testing.assert_close(
        world.means[0].double(), torch.from_numpy(frame.to_world(before.means[0].numpy())).float().double()
    )
    assert world.quaternions is before.quaternions and world.sh is before.sh


def test_coefficients_that_fit_no_degree_are_refused():
    odd = splats().with_sh(torch.zeros(6, 5, 3))
    with pytest.raises(BadSetting, match="5 SH coefficients"):
        _ = odd.degree
