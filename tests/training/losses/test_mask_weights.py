"""The mask as weights in the picture loss: they are raised if masks hide too much."""

import pytest
import torch

from core.training.losses import mask_weights


def test_collapsed_masks_are_raised_to_the_floor():
    shown = torch.full((20, 20), 0.2)
    for mask_mean, expected in (
        (0.2, mask_weights.LEAST_STATIC),
        (mask_weights.LEAST_STATIC, 0.2),
        (0.9, 0.2),
        (1.0, 0.2),
    ):
        assert float(mask_weights.pixel_weights(shown, torch.tensor(mask_mean)).mean()) == pytest.approx(expected)
