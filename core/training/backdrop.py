"""What is drawn behind everything: black, or where photos show empty space a new colour at each step, and white in figures.

Over one colour alone, Gaussians of that colour would pass for empty space. White is what the figures of Blender's scenes
(NeRF, Mildenhall et al. 2020) are measured over.
"""

import torch

from core.config import AUTO, Settings
from core.data.collection import Collection
from core.rasterizer import BLACK, Colour

WHITE: Colour = (1.0, 1.0, 1.0)
CUT_OUT = ("blender",)  # kinds of collections whose transparent pixels say that the scene is empty there, not that nobody saw it


def looks_for_empty(collection: Collection, settings: Settings) -> bool:
    """Whether photos are decoded together with where they are empty; not if a dome is asked for, which would fill that."""
    if settings.transparency != AUTO:
        return is_cut_out(settings)
    return collection.kind in CUT_OUT and settings.sky != "dome"


def is_cut_out(settings: Settings) -> bool:
    """Whether transparent pixels are learnt and scored as empty space, once that is decided (core.training.needs)."""
    return settings.transparency == "empty"


def of_figures(cut_out: bool) -> Colour:
    """What held-out photos and renders are compared over, and pictures shown over."""
    return WHITE if cut_out else BLACK


def of_step(cut_out: bool, generator: torch.Generator) -> Colour:
    """What photo and render of a step are compared over."""
    return tuple(torch.rand(3, generator=generator).tolist()) if cut_out else BLACK
