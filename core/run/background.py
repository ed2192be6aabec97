"""What is drawn behind everything: black. Where transparent pixels are empty,
a new colour at each step of training, and white in figures.

Over one colour alone, Gaussians of that colour would pass for empty space. White is what the figures of Blender's
scenes (NeRF, Mildenhall et al. 2020) are measured over.
"""

import torch

from core.rasterizer import BLACK, Colour

WHITE: Colour = (1.0, 1.0, 1.0)


def background_of_figures(transparent_is_empty: bool) -> Colour:
    """What held-out photos and renders are compared over, and pictures shown over."""
    return WHITE if transparent_is_empty else BLACK


def background_of_step(transparent_is_empty: bool, generator: torch.Generator) -> Colour:
    """What photo and render of a step are compared over."""
    return tuple(torch.rand(3, generator=generator).tolist()) if transparent_is_empty else BLACK
