"""The mask as weights in the picture loss: held up where masks hide too much."""

import pytest
import torch

from core.training.losses import mask_weights


def test_collapsed_masks_are_raised_to_the_floor():
    mask = torch.full((1, 5, 5), 0.2)
    assert float(mask_weights.pixel_weights(mask, 20, 20, mask_mean=0.2).mean()) == pytest.approx(mask_weights.COLLAPSED)
    assert float(mask_weights.pixel_weights(mask, 20, 20, mask_mean=0.9).mean()) == pytest.approx(0.2)
