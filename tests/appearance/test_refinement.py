"""Refinement, of a look that is the picture's one colour: its embedding, times the gain of the place."""

import pytest
import torch

from core.appearance.refinement import CELLS, LEAST_SKY, STEPS, _cell_weights, refinement

PICTURE = torch.full((4, 6, 3), 0.4)


def flat(embedding, tone):
    return (embedding * tone[0]).expand(4, 6, 3)


def refined(picture, begin, valid=None, tone=None, bound=lambda embedding: embedding):
    """The last look."""
    *_, last = refinement(flat, bound, begin, picture, valid, tone)
    return last


def test_it_never_makes_what_it_sees_worse():
    """A hair off, where Adam's first step leads past the colour by nearly its rate."""
    begin = torch.full((3,), 0.4 + 1e-4)
    steps = list(refinement(flat, lambda embedding: embedding, begin, PICTURE))
    losses = [float((flat(*best) - PICTURE).abs().mean()) for best in steps]
    assert len(steps) == STEPS + 1 and torch.equal(steps[0].embedding, begin) and torch.equal(steps[1].embedding, begin)
    assert losses == sorted(losses, reverse=True) and losses[-1] < 2e-5  # the rate falls to zero


def test_invalid_pixels_do_not_count():
    picture, valid = PICTURE.clone(), torch.ones(4, 6, dtype=torch.bool)
    picture[:, 2:] = 0.9
    valid[:, 2:] = False
    found = refined(picture, torch.full((3,), 0.8), valid)
    assert (flat(*found) - 0.4).abs().max() < 0.01


def test_it_begins_with_the_tone_that_was_read_and_moves_it():
    begin, tone = torch.full((3,), 0.8), torch.tensor([[0.25, 0.5, 0.5], [0.1, 0.1, 0.1]])
    first = next(refinement(flat, lambda embedding: embedding, begin, PICTURE, tone=tone))
    torch.testing.assert_close(first.tone, tone)
    found = refined(PICTURE, begin, tone=tone)
    assert (flat(*found) - 0.4).abs().max() < 0.01 and found.tone[0, 0] > 0.25
    torch.testing.assert_close(found.tone[1], tone[1])  # nothing shows the sky


def test_what_is_finer_than_a_cell_does_not_move_a_look():
    """A chequered picture, in cells of two pixels a side, has the colour of its means."""
    side = 2 * CELLS
    chequered = torch.full((side, side, 3), 0.4)
    chequered[::2, ::2] = chequered[1::2, 1::2] = 0.9
    *_, found = refinement(lambda embedding, tone: (embedding * tone[0]).expand(side, side, 3), lambda e: e, torch.full((3,), 0.5), chequered)
    assert (found.embedding * found.tone[0] - 0.65).abs().max() < 1e-3  # by single pixels any colour between the two fits as well


@pytest.mark.parametrize("columns, weight", [(0, 1.0), (10, 1.0), (20, 1.0), (30, 1 / 3), (39, LEAST_SKY), (40, LEAST_SKY)])
def test_the_sky_counts_no_more_than_the_place(columns, weight):
    sky = torch.zeros(CELLS, CELLS)
    sky[:, :columns] = 1
    weights = _cell_weights(sky, None)[0, 0]
    torch.testing.assert_close(weights[:, :columns], torch.full((CELLS, columns), weight))
    assert (weights[:, columns:] == 1).all()


def test_what_a_photo_does_not_show_is_no_place():
    sky, valid = torch.zeros(CELLS, CELLS), torch.ones(CELLS, CELLS, dtype=torch.bool)
    sky[:, :10], valid[:, 14:] = 1, False
    assert _cell_weights(sky, valid)[0, 0, 0, 0] == pytest.approx(0.4)


def test_an_embedding_stays_where_it_may_go():
    found = refined(PICTURE, torch.full((3,), 0.8), bound=lambda embedding: embedding.clamp(min=0.7))
    assert found.embedding.min() >= 0.7 and (flat(*found) - 0.4).abs().max() < 0.01  # the tone does the rest


def test_a_look_that_follows_no_embedding_is_left_alone():
    assert not list(refinement(lambda embedding, tone: PICTURE * tone[0], lambda embedding: embedding, torch.zeros(3), PICTURE))


@pytest.mark.parametrize("size", [(1, 1), (3, 200), (200, 3)])
def test_pictures_of_any_shape(size):
    picture = torch.full((*size, 3), 0.4)
    *_, found = refinement(lambda embedding, tone: (embedding * tone[0]).expand(*size, 3), lambda e: e, torch.full((3,), 0.5), picture)
    assert (found.embedding * found.tone[0] - 0.4).abs().max() < 1e-3
