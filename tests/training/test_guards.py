"""Which steps are skipped: those with a gradient that is not finite, and those whose loss is a spike."""

import math

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
    assert guards.usual_loss([0.3, None, 0.1, 9.0]) == 0.3 and guards.usual_loss([None, None]) == math.inf
    assert [guards.largest_loss(usual) for usual in (0.3, 0.1, math.inf)] == [3.0, 2.0, math.inf]
