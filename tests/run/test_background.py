"""What is drawn behind everything: in training never the same twice, where transparent pixels are empty."""

import torch

from core.run.background import background_of_step


def test_every_step_has_a_colour_of_its_own():
    """Over one colour alone, Gaussians of that colour would pass for empty space."""
    generator = torch.Generator().manual_seed(0)
    drawn = torch.tensor([background_of_step(True, generator) for _ in range(50)])
    assert drawn.min() >= 0 and drawn.max() <= 1 and (drawn.std(dim=0) > 0.2).all()
    assert background_of_step(False, generator) == (0.0, 0.0, 0.0)
