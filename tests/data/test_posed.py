"""Poses as other programs write them."""

import numpy as np
import pytest

from core.data.posed import Fault, from_camera_to_world, usable_points

TURN = np.array([[0.0, -1, 0, 2], [1, 0, 0, 3], [0, 0, 1, 4], [0, 0, 0, 1]])


@pytest.mark.parametrize("scale", [1.0, 1e-3, 50.0])
def test_a_pose_gives_rotation_and_centre(scale):
    rotation, centre = from_camera_to_world(TURN * [scale, scale, scale, 1], "a pose")
    assert np.allclose(rotation, TURN[:3, :3].T, rtol=0, atol=1e-15) and (centre == [2, 3, 4]).all()


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        (TURN * [1, 1, -1, 1], "that is mirrored"),
        (TURN * [1, 1, 1.02, 1], "that is not a rotation"),
        (TURN * [0, 0, 0, 1], "that is not a rotation"),
        (TURN * [1, 1, np.nan, 1], "not finite"),
        (TURN * [1, 1, 1, np.inf], "not finite"),
        (TURN * [1, 1, 1, 1e200], "not finite"),
    ],
)
def test_what_is_no_pose_is_refused(matrix, words):
    with pytest.raises(Fault, match=f"^with a pose .*{words}"):
        from_camera_to_world(matrix, "a pose")


def test_points_at_absurd_places_are_counted():
    points = np.random.default_rng(0).normal(size=(20, 3))
    assert usable_points(points)[0].all() and usable_points(points)[1] == []
    points[3, 0], points[4, 1], points[5, 2] = np.nan, 1e200, 1e9
    good, notes = usable_points(points)
    assert np.flatnonzero(~good).tolist() == [3, 4, 5] and notes[0].text.startswith("3 points at NaN")
    assert not usable_points(np.full((2, 3), np.nan))[0].any()
