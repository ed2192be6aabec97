"""Which steps are skipped: those with a gradient that is not finite, and those whose loss is a spike."""

import math
import random
import statistics
import time

import pytest
import torch

from core.training import guards


@pytest.mark.parametrize("where", ["cpu", "meta"])
def test_gradients_that_are_not_finite_are_found(where):
    """By the ways of a CPU and of a GPU; gradients of a view of nothing are empty."""
    where = torch.device(where)
    good = [torch.ones(3), None, torch.zeros(0, 4), torch.full((2,), -1e30)]
    assert guards.finite(good, where)
    for bad in (torch.nan, torch.inf, -torch.inf):
        assert not guards.finite([*good, torch.tensor([1.0, bad])], where)
    assert guards.finite([torch.zeros(0)], torch.device("cpu"))


def test_a_loss_is_a_spike_from_ten_times_the_usual_one_on_but_never_below_what_an_odd_photo_costs():
    assert guards.LastLosses([0.3, None, 0.1, 9.0]).usual == 0.3
    assert guards.LastLosses([None, None]).usual == math.inf
    assert [guards.largest_loss(usual) for usual in (0.3, 0.1, math.inf)] == [3.0, 2.0, math.inf]


def test_the_usual_loss_is_the_median_of_the_last_ones_after_every_step():
    chance, last = random.Random(0), [None, 0.5, None, 0.2, None, 0.5]
    by_photo = list(last)
    losses = guards.LastLosses(by_photo)
    for _ in range(100):
        index, loss = chance.randrange(len(last)), chance.choice([0.1, 0.2, 0.5, chance.random()])
        last[index] = loss
        losses.replace(index, loss)
        assert by_photo == last and losses.usual == statistics.median(each for each in last if each is not None)


def test_the_usual_loss_of_thousands_of_photos_costs_a_step_next_to_nothing():
    """A step on a GPU waits for it; sorted anew, it took a tenth of such a step."""
    chance = random.Random(0)
    losses = guards.LastLosses([chance.random() for _ in range(100_000)])
    start = time.process_time()
    for index in range(100):
        losses.replace(index, chance.random())
        assert losses.usual > 0
    assert time.process_time() - start < 0.1  # sorted anew: over 2 s
