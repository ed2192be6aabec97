"""Where a camera goes between views: evenly, about what they show, and through each of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.scene.camera import Camera
from core.scene.camera_path import camera_path

START = Camera(np.eye(3), np.array([0.0, 0.0, 0.0]), 100.0, 100.0, 50.0, 40.0, 100, 80)
QUARTER = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # about the y axis
END = Camera(QUARTER, np.array([2.0, 0.0, 4.0]), 400.0, 400.0, 80.0, 100.0, 160, 200)
ORIGIN = np.zeros(3)


def facing(degrees: float, distance: float) -> Camera:
    """A camera that looks at the origin from this side of it."""
    rotation = Rotation.from_euler("y", -degrees, degrees=True).as_matrix()
    return Camera.centred(rotation, rotation.T @ [0, 0, -distance], 100.0, 100, 80)


def test_between_two_views_a_camera_moves_straight_and_turns_evenly():
    first, half, whole = camera_path([START, END], 3, None)
    assert first is START
    np.testing.assert_allclose(half.world_to_camera @ half.world_to_camera, QUARTER, atol=1e-12)
    np.testing.assert_allclose(whole.world_to_camera, QUARTER, atol=1e-12)
    np.testing.assert_allclose([half.centre, whole.centre], [[1, 0, 2], [2, 0, 4]], atol=1e-12)
    assert (half.fx, half.fy, whole.fx) == pytest.approx((150, 150, 200))  # the other's picture is twice as long
    assert (whole.cx, whole.cy, whole.width, whole.height) == (50.0, 40.0, 100, 80)


def test_a_camera_stays_where_it_has_nowhere_to_go():
    assert camera_path([START], 3, ORIGIN) == [START] * 3
    for camera in camera_path([END, END], 3, ORIGIN):
        np.testing.assert_allclose(camera.numbers(), END.numbers(), atol=1e-12)


def test_a_camera_goes_around_what_both_views_show_and_that_crosses_the_picture_evenly():
    beside = np.array([0.6, 0.0, 0.0])
    views = [facing(0, 4), facing(179, 6)]
    path = camera_path(views, 5, beside)
    distances = [np.linalg.norm(camera.centre - beside) for camera in path]
    assert np.all(np.diff(distances) > 0) and abs(path[2].centre[0]) > 4  # from side to side, and not through it
    seen = np.array([np.append(*camera.project(beside[None])) for camera in path])  # pixel and depth
    np.testing.assert_allclose(seen, np.linspace(seen[0], seen[-1], 5), atol=1e-9)
    np.testing.assert_allclose(path[-1].centre, views[-1].centre, atol=1e-12)


def test_what_both_views_show_stays_in_the_picture_through_a_zoom():
    near, far = (
        replace(START, fx=focal, fy=focal, centre=np.array([0, 0, -depth])) for focal, depth in ((100, 1), (1000, 10))
    )
    beside = np.array([0.45, 0.0, 0.0])
    for camera in camera_path([near, far], 9, beside):
        assert camera.project(beside[None])[0] == pytest.approx(np.array([[95, 40]]))


@pytest.mark.parametrize("sides", [(0, 5, 120, 125), (0, 60, 60, 90), (0, 1e-5, 90, 180), (0, 100, 101, 170)])
def test_a_camera_turns_no_farther_than_its_views(sides):
    """However unevenly they lie, and where one is given twice."""
    path = camera_path([facing(degrees, 4) for degrees in sides], 100 * (len(sides) - 1) + 1, ORIGIN)
    turned = np.degrees([np.arctan2(-camera.centre[0], -camera.centre[2]) for camera in path])
    assert np.all(np.diff(np.mod(turned + 90, 360)) > -1e-3)


def test_a_camera_passes_through_every_view_without_a_jolt():
    views = [facing(degrees, distance) for degrees, distance in ((0, 4), (90, 6), (180, 3), (290, 5))]
    path = camera_path(views, 301, ORIGIN)
    for view, camera in zip(views, path[::100], strict=True):
        np.testing.assert_allclose(camera.numbers(), view.numbers(), atol=1e-9)
    for values in ([camera.centre for camera in path], [camera.world_to_camera.ravel() for camera in path]):
        steps = np.diff(values, axis=0)
        jolts = np.linalg.norm(np.diff(steps, axis=0), axis=1)
        assert jolts.max() < 0.1 * np.linalg.norm(steps, axis=1).max()
    distances = [np.linalg.norm(camera.centre) for camera in path]
    assert 3 - 1e-9 < min(distances) and max(distances) < 6 + 1e-9
