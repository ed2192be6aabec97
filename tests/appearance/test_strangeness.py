"""How strange places of a photo are found; what follows from it is tested with the mask's loss and with refinement."""

import pytest
import torch

from core.appearance.strangeness import USUAL, quantile, retoned


@pytest.mark.parametrize(
    "picture", [torch.zeros(3, 12, 16), torch.full((3, 12, 16), 0.7)], ids=["black", "of one colour"]
)
def test_a_picture_of_one_colour_can_be_retoned(picture):
    torch.testing.assert_close(retoned(picture, picture), picture)
    moved = retoned(picture, picture + 0.1)
    assert torch.isfinite(moved).all() and float((moved - picture - 0.1).abs().max()) < 1e-3


def test_quantiles_are_torchs():
    values = torch.rand(7, 11, generator=torch.Generator().manual_seed(0))
    for share in (0.0, 0.5, USUAL, 1.0):
        torch.testing.assert_close(quantile(values, share), torch.quantile(values, share))
