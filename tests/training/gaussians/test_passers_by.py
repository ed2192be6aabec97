"""Passers-by: what masks hide in few photos, and not what they hide in many, or show."""

import numpy as np
import pytest
import torch

from core import rasterizer
from core.scene.camera import Camera
from core.scene.splats import Splats
from core.training.gaussians.passers_by import FEW, passers_by

REFERENCE = rasterizer.create("reference")
SIDE = 64  # px
PLACES = np.array([[-0.5, -0.5, 2.0], [0.5, -0.5, 2.0], [-0.5, 0.5, 2.0], [0.5, 0.5, 2.0]])  # one in each quarter of the picture


def camera() -> Camera:
    return Camera(np.eye(3), np.zeros(3), SIDE, SIDE, SIDE / 2, SIDE / 2, SIDE, SIDE)


def quarters(*hidden: int) -> torch.Tensor:
    """A mask of 16 x 16 that hides some quarters of the picture."""
    mask = torch.ones(1, 2, 2)
    mask.view(4)[list(hidden)] = 0
    return mask.repeat_interleave(8, 1).repeat_interleave(8, 2)


@pytest.fixture
def splats() -> Splats:
    straight = torch.tensor([[1.0, 0, 0, 0]]).repeat(4, 1)
    return Splats(torch.tensor(PLACES).float(), straight, torch.full((4, 3), 0.1).log(), torch.full((4,), 3.0), torch.zeros(4, 1, 3))


def test_what_few_photos_hide_of_what_few_photos_show(splats):
    """The first is hidden in one photo of three, the second in one of four, the third nowhere."""
    photos = [(camera(), quarters(0)), (camera(), quarters()), (camera(), quarters())]
    assert passers_by(splats, photos, REFERENCE).tolist() == [True, False, False, False]
    assert not passers_by(splats, [*photos, (camera(), quarters())], REFERENCE).any()


def test_what_many_photos_hide_belongs_to_the_place(splats):
    assert passers_by(splats, [(camera(), quarters(3))] * (FEW - 1), REFERENCE).tolist() == [False, False, False, True]
    assert not passers_by(splats, [(camera(), quarters(3))] * (FEW + 1), REFERENCE).any()


def test_photos_that_hide_next_to_nothing_of_it_do_not_count(splats):
    """Others see it from four times as far off, and so a sixteenth as much of it."""
    far = Camera(np.eye(3), np.array([0.0, 0.0, -6.0]), SIDE, SIDE, SIDE / 2, SIDE / 2, SIDE, SIDE)
    everywhere = quarters(0, 1, 2, 3)
    assert passers_by(splats, [(camera(), everywhere)] * (FEW - 1) + [(far, everywhere)] * 3, REFERENCE).all()


def test_what_no_photo_shows_is_none(splats):
    behind = Camera(np.diag([-1.0, 1.0, -1.0]), np.zeros(3), SIDE, SIDE, SIDE / 2, SIDE / 2, SIDE, SIDE)
    assert not passers_by(splats, [(behind, quarters(0, 1, 2, 3))], REFERENCE).any()
    assert not passers_by(splats, [], REFERENCE).any()
