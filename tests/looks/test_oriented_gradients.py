"""Dense features: what they do not depend on, and that what is moved is found where it was moved to."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from core.looks.oriented_gradients import GRID_PX, GridFeatures, Pairs, coherence, matches, matches_nearby


@pytest.fixture(scope="module")
def texture() -> torch.Tensor:
    noise = torch.rand(1, 3, 40, 60, generator=torch.Generator().manual_seed(0))
    return F.interpolate(noise, size=(160, 240), mode="bicubic")[0].permute(1, 2, 0).clamp(0, 1)


def window(texture: torch.Tensor, right: int, down: int) -> torch.Tensor:
    return texture[20 + down : 140 + down, 20 + right : 220 + right]


def test_light_and_the_sign_of_edges_change_nothing(texture):
    features = GridFeatures.of(texture)
    assert features.descriptors.shape[1:] == (40, 60)
    for other in (0.2 * texture + 0.5, 1 - texture):
        torch.testing.assert_close(GridFeatures.of(other).descriptors, features.descriptors, rtol=0, atol=2e-3)


def test_what_is_flat_or_not_used_matches_nothing(texture):
    half = texture.clone()
    half[:, 120:] = 0.5
    use = np.ones(half.shape[:2], bool)
    use[:80] = False
    features = GridFeatures.of(half).only(use)
    for first, second, _ in (matches(features, features), matches_nearby(features, features, 2, 0.5)):
        assert np.array_equal(first, second)
        x, y = features.pixels[first].T
        assert len(first) > 400 and x.max() < 120 + 4 * GRID_PX and y.min() > 80


@pytest.mark.parametrize("right, down", [(0, 0), (8, -4), (2, 1), (-6, 3)])
def test_what_is_moved_is_found_there_to_within_a_part_of_a_grid_step(texture, right, down):
    first, second = (GridFeatures.of(window(texture, *by)) for by in ((0, 0), (right, down)))
    pairs = matches_nearby(first, second, 3, 0.5)
    moved = first.pixels[pairs.first] + pairs.offset - second.pixels[pairs.second]
    assert len(moved) > 0.5 * 30 * 50
    np.testing.assert_allclose(np.median(moved, axis=0), (right, down), atol=0.5)
    if right % GRID_PX == down % GRID_PX == 0:
        anywhere = matches(first, second)
        same = first.pixels[anywhere.first] - second.pixels[anywhere.second] == (right, down)
        assert same.all(axis=1).mean() > 0.8  # all but what one picture alone shows


def test_nothing_is_found_farther_away_than_the_reach(texture):
    first, second = (GridFeatures.of(window(texture, right, 0)) for right in (0, 5 * GRID_PX))
    within, beyond = (len(matches_nearby(first, second, reach, 0.8).first) for reach in (5, 4))
    assert within > 1000 > 5 * beyond


def test_matches_are_coherent_where_neighbours_stay_neighbours(texture):
    first, second = (GridFeatures.of(window(texture, right, 0)) for right in (0, 2 * GRID_PX))
    first = GridFeatures.of(window(texture, 0, 0)[:100])  # so that the grids differ
    pairs = matches(first, second)
    assert 1.6 * len(pairs.first) < coherence(pairs, first, second) < 2 * len(pairs.first)
    mixed = np.random.default_rng(0).permutation(pairs.second)
    assert coherence(pairs._replace(second=mixed), first, second) < 0.05 * len(pairs.first)
    none = Pairs(*(each[:0] for each in pairs))
    assert coherence(none, first, second) == 0


def test_neighbours_that_change_sides_are_not_coherent(texture):
    features = GridFeatures.of(texture)
    every = np.arange(40 * 60)
    assert coherence(Pairs(every, every, np.zeros((2400, 2))), features, features) == 39 * 60 + 40 * 59
    assert coherence(Pairs(every, every[::-1], np.zeros((2400, 2))), features, features) == 0
