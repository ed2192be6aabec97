"""Holes in photos are filled from around them, whatever stood there."""

import numpy as np
import pytest

from core.data.photos.fill import fill


def photo_and_hole(height, width):
    random = np.random.default_rng(1)
    use = np.ones((height, width), bool)
    use[height // 3 :, width // 4 : width // 2 + 1] = False
    return random.integers(0, 256, (height, width, 3), np.uint8), use


@pytest.mark.parametrize("height, width", [(3, 5), (17, 40), (64, 48)])
def test_what_is_used_stays_and_what_is_not_has_no_influence(height, width):
    pixels, use = photo_and_hole(height, width)
    filled = fill(pixels, use)
    assert (filled[use] == pixels[use]).all()
    for colour in ((255, 128, 0), (0, 0, 0)):
        np.testing.assert_array_equal(fill(np.where(use[..., None], pixels, np.uint8(colour)), use), filled)


def test_holes_go_on_as_their_surroundings_do():
    _, use = photo_and_hole(48, 64)
    use[10:14, 40:60] = False
    plain = np.full((48, 64, 3), (200, 100, 7), np.uint8)
    np.testing.assert_array_equal(fill(plain, use), plain)
    halves = plain.copy()
    halves[24:] = (10, 20, 30)
    hole = np.ones((48, 64), bool)
    hole[8:16, 20:28] = hole[32:40, 20:28] = False  # 8 px from the other colour, and no wider
    # A colour from 8 px away, over holes of 8 px: less than a quarter of it may get in.
    assert np.abs(fill(halves, hole).astype(int) - halves).max() < 0.25 * 190


def test_one_pixel_is_enough():
    use = np.zeros((5, 9), bool)
    use[4, 8] = True
    pixels = np.zeros((5, 9, 3), np.uint8)
    pixels[4, 8] = (1, 2, 3)
    assert (fill(pixels, use) == (1, 2, 3)).all()
