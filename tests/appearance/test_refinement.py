"""Refinement, of an embedding that is the picture's one colour."""

import torch

from core.appearance.refinement import STEPS, refined, refinement

PICTURE = torch.full((4, 6, 3), 0.4)


def flat(embedding):
    return embedding.expand(4, 6, 3)


def test_it_never_makes_what_it_sees_worse():
    """A hair off, where Adam's first step leads past the colour by nearly its rate."""
    begin = torch.full((3,), 0.4 + 1e-4)
    steps = list(refinement(flat, begin, PICTURE))
    losses = [float((flat(best) - PICTURE).abs().mean()) for best in steps]
    assert len(steps) == STEPS + 1 and torch.equal(steps[0], begin) and torch.equal(steps[1], begin)
    assert losses == sorted(losses, reverse=True)
    assert torch.equal(refined(flat, begin, PICTURE), steps[-1])


def test_invalid_pixels_do_not_count():
    picture, valid = PICTURE.clone(), torch.ones(4, 6, dtype=torch.bool)
    picture[:, 2:] = 0.9
    valid[:, 2:] = False
    found = refined(flat, torch.full((3,), 0.8), picture, valid)
    assert (found - 0.4).abs().max() < 0.02  # the best of 128 steps at a rate of 0.1


def test_a_look_that_follows_nothing_is_left_alone():
    assert refined(lambda embedding: PICTURE, torch.zeros(3), PICTURE) is None
