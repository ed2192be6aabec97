"""Down is found from how photos are held, and models are turned by it."""

import cv2
import numpy as np
import pycolmap
import pytest

from core.data.sfm.upright import find_down, turn_upright
from tests.data.small_scene import SmallScene

DOWN = np.array([0.36, -0.48, 0.8])


def held(yaw, tilt, roll):
    """World-to-camera rotations, whose angles are given in degrees each; yaw about DOWN, tilt upwards."""
    ahead, _ = np.linalg.qr(np.stack([DOWN, [1.0, 0, 0], [0, 1.0, 0]], axis=1))
    level = np.array([np.cross(DOWN, ahead[:, 1]), DOWN, ahead[:, 1]])
    for turn in zip(np.radians(roll), -np.radians(tilt), np.radians(yaw), strict=True):
        yield np.linalg.multi_dot(
            [cv2.Rodrigues(angle * np.eye(3)[axis])[0] for angle, axis in zip(turn, (2, 0, 1), strict=True)] + [level]
        )


def degrees_off(axes):
    return np.degrees(np.arccos(np.clip(find_down(np.array(list(axes))) @ DOWN, -1, 1)))


def test_down_is_found_from_tourists_who_look_up():
    random = np.random.default_rng(0)
    yaw, tilt, roll = random.uniform(-40, 40, 30), random.normal(20, 8, 30), random.normal(0, 2, 30)
    assert degrees_off(held(yaw, tilt, roll)) < 2  # the mean photo's own down is 20 degrees off
    roll[:8] += 90  # taken on edge
    assert degrees_off(held(yaw, tilt, roll)) < 3


@pytest.mark.parametrize("tilt", (-90, 45))
def test_down_is_found_from_above_and_from_below(tilt):
    yaw = np.arange(0, 360, 30.0)
    assert degrees_off(held(yaw, np.full(12, tilt), np.zeros(12))) < 0.1


def test_down_is_found_from_two_photos_back_to_back():
    """They look nowhere on the whole."""
    assert find_down(np.array([np.eye(3), np.diag([-1.0, 1.0, -1.0])])) == pytest.approx(np.array([0, 1, 0]))


def test_down_is_that_of_the_photos_if_all_look_one_way():
    """All that is known is what is below in the photos."""
    assert degrees_off(held(np.zeros(5), np.full(5, 10), np.zeros(5))) == pytest.approx(10, abs=0.1)


@pytest.mark.parametrize("tilt", (15, -90))
def test_a_model_is_turned_upright(tilt):
    """Its photos see the same points in the same places; down is +y and, seen from their middle, ahead is +z."""
    axes = list(held([-25, -5, 15, 15], [tilt] * 4, [0] * 4))

    class Held(SmallScene):
        def pose(self, index):
            return pycolmap.Rigid3d(pycolmap.Rotation3d(axes[index]), np.array([0.1 * index, 0, 0.2]))

    scene = Held()
    model = scene.reconstruction()
    model.deregister_frame(model.images[4].frame_id)  # a photo without a place stays in the model
    posed = [model.images[number] for number in (1, 2, 3)]
    before = [image.cam_from_world() * scene.points for image in posed]
    turn_upright(model)
    points = np.array([model.points3D[number].xyz for number in sorted(model.points3D)])
    np.testing.assert_allclose([image.cam_from_world() * points for image in posed], before, atol=1e-9)
    poses = [image.cam_from_world().rotation.matrix() for image in posed]
    np.testing.assert_allclose(find_down(np.array(poses)), [0, 1, 0], atol=1e-9)
    ahead = np.mean(poses, axis=0)[2]
    assert abs(ahead[0]) < 1e-9 and (ahead[2] > 0.5 or tilt == -90)
