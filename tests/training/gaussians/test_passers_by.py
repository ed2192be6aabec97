"""Gaussians of passers-by: those that masks hide in few photos, not those that they hide in many, or show."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from core.scene.splats import Splats
from core.training.gaussians.passers_by import FEW, passers_by
from tests.training.gaussians.test_veils import REFERENCE, looking_ahead, opaque

# One in each quarter of the picture.
PLACES = np.array([[-0.5, -0.5, 2.0], [0.5, -0.5, 2.0], [-0.5, 0.5, 2.0], [0.5, 0.5, 2.0]])
CAMERA = looking_ahead(0.0).resized(64, 64)


def quarters(*hidden: int) -> torch.Tensor:
    """A mask of 16 x 16 that hides some quarters of the picture."""
    mask = torch.ones(1, 2, 2)
    mask.view(4)[list(hidden)] = 0
    return mask.repeat_interleave(8, 1).repeat_interleave(8, 2)


@pytest.fixture
def splats() -> Splats:
    return opaque(PLACES, 0.1)


def test_what_masks_hide_in_a_large_share_of_few_photos_is_a_passer_by(splats):
    """Hidden in one photo of three, a Gaussian is a passer-by; hidden in one of four, it is not."""
    photos = [(CAMERA, quarters(0)), (CAMERA, quarters()), (CAMERA, quarters())]
    assert passers_by(splats, photos, REFERENCE).tolist() == [True, False, False, False]
    assert not passers_by(splats, [*photos, (CAMERA, quarters())], REFERENCE).any()


def test_what_many_photos_hide_belongs_to_the_place(splats):
    assert passers_by(splats, [(CAMERA, quarters(3))] * (FEW - 1), REFERENCE).tolist() == [False, False, False, True]
    assert not passers_by(splats, [(CAMERA, quarters(3))] * (FEW + 1), REFERENCE).any()


def test_photos_that_hide_next_to_nothing_of_it_do_not_count(splats):
    """Others see it from four times as far off, and so a sixteenth as much of it."""
    far = replace(CAMERA, centre=np.array([0.0, 0.0, -6.0]))
    everywhere = quarters(0, 1, 2, 3)
    assert passers_by(splats, [(CAMERA, everywhere)] * (FEW - 1) + [(far, everywhere)] * 3, REFERENCE).all()


def test_what_no_photo_shows_is_no_passer_by(splats):
    behind = looking_ahead(0.0, turned=True).resized(64, 64)
    assert not passers_by(splats, [(behind, quarters(0, 1, 2, 3))], REFERENCE).any()
    assert not passers_by(splats, [], REFERENCE).any()
