"""Veils: Gaussians that hide the view of a camera beside that of a photo, and no others."""

import numpy as np
import pytest
import torch

from core import rasterizer
from core.rasterizer.importance import largest_shares
from core.scene.camera import Camera
from core.scene.splats import Splats
from core.training.gaussians.veils import LARGEST_STEP, MOST_VIEWS, VIEWS_PER_PHOTO, cameras_beside, veils

WALL = np.array([[x, y, 5.0] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
REFERENCE = rasterizer.create("reference")


def looking_ahead(x: float, turned: bool = False) -> Camera:
    return Camera(
        np.diag([-1.0, 1.0, -1.0]) if turned else np.eye(3), np.array([x, 0.0, 0.0]), 48.0, 48.0, 24.0, 24.0, 48, 48
    )


def opaque(means: np.ndarray, size: float) -> Splats:
    count = len(means)
    straight = torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1)
    return Splats(
        torch.tensor(means).float(),
        straight,
        torch.full((count, 3), size).log(),
        torch.full((count,), 3.0),
        torch.zeros(count, 1, 3),
    )


def test_what_floats_between_two_cameras_is_a_veil_and_what_they_photograph_is_none():
    photos = [looking_ahead(x) for x in (-1.0, 1.0)]
    wall, floater, in_a_photo = (
        opaque(WALL, 0.3),
        opaque(np.array([[0.2, 0.0, 0.4]]), 0.1),
        opaque(np.array([[-1.0, 0.0, 0.4]]), 0.1),
    )
    found = veils(Splats.concatenate([wall, floater, in_a_photo]), photos, WALL, REFERENCE)
    assert found.tolist() == [False] * len(WALL) + [True, False]


def test_the_share_of_a_picture_is_what_a_gaussian_adds_to_it():
    cameras, splats = [looking_ahead(0.0), looking_ahead(0.5)], opaque(WALL, 0.3)
    expected = []
    for row in range(len(WALL)):
        drawn = [REFERENCE.render(splats.marked(torch.arange(len(WALL)) == row), camera).mean() for camera in cameras]
        expected.append(max(map(float, drawn)))
    assert largest_shares(splats, cameras, REFERENCE).tolist() == pytest.approx(expected, rel=1e-4)


def test_new_cameras_are_no_farther_off_than_others_nor_half_the_way_to_what_they_show():
    for apart, most in ((0.6, 0.6), (6.0, LARGEST_STEP * 5.0)):
        photos = [looking_ahead(x * apart) for x in (0, 1, 1, 1)]
        beside = cameras_beside(photos, WALL + [apart / 2, 0, 0])
        nearest = [min(np.linalg.norm(camera.centre - photo.centre) for photo in photos) for camera in beside]
        assert len(beside) == 4 * VIEWS_PER_PHOTO and 0.6 * most < max(nearest) <= most
        assert [camera.numbers() for camera in beside] == [
            camera.numbers() for camera in cameras_beside(photos, WALL + [apart / 2, 0, 0])
        ]


def test_no_new_cameras_beside_a_lone_photo_or_one_without_points():
    assert not cameras_beside([looking_ahead(0.0)], WALL)
    assert not cameras_beside([looking_ahead(0.0), looking_ahead(0.1, turned=True)], WALL)
    assert not cameras_beside([looking_ahead(0.0), looking_ahead(0.1)], np.zeros((0, 3)))
    assert not veils(opaque(WALL, 0.3), [looking_ahead(0.0)], WALL, REFERENCE).any()


def test_new_cameras_of_many_photos_are_limited_and_beside_all_alike():
    photos = [looking_ahead(x) for x in np.linspace(-0.5, 0.5, MOST_VIEWS)]
    assert len(cameras_beside(photos, WALL)) == MOST_VIEWS
