"""Which steps are not taken: those with a gradient that is not finite, wherever it is looked for."""

import pytest
import torch

from core.training import guards


@pytest.mark.parametrize("where", ["cpu", "meta"])
def test_gradients_that_are_not_finite_are_found(where):
    """As a CPU looks for them, and as a GPU does; of a view of nothing they have no numbers."""
    where = torch.device(where)
    good = [torch.ones(3), None, torch.zeros(0, 4), torch.full((2,), -1e30)]
    assert guards.finite(good, where)
    for bad in (torch.nan, torch.inf, -torch.inf):
        assert not guards.finite([*good, torch.tensor([1.0, bad])], where)
    assert guards.finite([torch.zeros(0)], torch.device("cpu"))
