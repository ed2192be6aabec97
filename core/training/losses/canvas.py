"""Photos of all sizes on one canvas, so that on a GPU the kernels of a step are the same for each of them."""

from collections.abc import Callable
from functools import lru_cache

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from core.training.losses.photometric import Target

MATRICES = 64  # of either kind that are cached, as photos share sides; 0.4 MB each at 1600 px


class TargetOnCanvas(Target):
    """A photo in the upper left corner of a larger canvas, beyond which nothing is valid;
    see Target, whose sizes are the canvas's.

    shape: height and width of the canvas, px. cells: height and width of the masks it is compared under. averaging,
    enlarging: the matrices (cells, pixels) from the canvas's pixels to cells and back, one for the columns and one for
    the rows. Whatever differs between photos is in `tensors`, so that another photo's can be copied into them
    (core.training.step_cuda).
    """

    valid_pixels: Tensor

    def __init__(
        self,
        picture: Float[Tensor, "h w 3"],
        valid: Bool[Tensor, "h w"] | None,
        shape: tuple[int, int],
        cells: tuple[int, int],
    ):
        height, width = picture.shape[:2]
        beyond = 0, shape[1] - width, 0, shape[0] - height
        shown = torch.ones(height, width, dtype=torch.bool, device=picture.device) if valid is None else valid
        shown = F.pad(shown, beyond)
        super().__init__(F.pad(picture, (0, 0, *beyond)), shown)
        self.valid, self.valid_pixels = shown, shown.sum(dtype=torch.float32)

        def on_both_axes(weights: Callable[[int, int], Tensor]) -> tuple[Tensor, ...]:
            axes = zip(cells, (height, width), shape, strict=True)
            return tuple(F.pad(weights(count, side), (0, whole - side)).to(picture) for count, side, whole in axes)

        self.averaging, self.enlarging = on_both_axes(_averaging), on_both_axes(_enlarging)

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        """All that differs between two photos on one canvas."""
        return *super().tensors, self.valid_pixels, *self.averaging, *self.enlarging

    def to_cells(self, planes: Float[Tensor, "3 H W"], height: int, width: int) -> Float[Tensor, "3 h w"]:
        down, across = self.averaging
        return down @ planes @ across.T

    def to_pixels(self, cells: Float[Tensor, "1 h w"]) -> Float[Tensor, "H W"]:
        down, across = self.enlarging
        return down.T @ cells[0] @ across


@lru_cache(MATRICES)
def _averaging(cells: int, pixels: int) -> Float[Tensor, "cells pixels"]:
    """The matrix that averages the pixels of an axis into cells, as torch's mode "area" does."""
    return F.interpolate(torch.eye(pixels)[None], size=cells, mode="area")[0].T


@lru_cache(MATRICES)
def _enlarging(cells: int, pixels: int) -> Float[Tensor, "cells pixels"]:
    """The matrix whose transpose enlarges the cells of an axis to pixels, as torch's mode "linear" does."""
    return F.interpolate(torch.eye(cells)[None], size=pixels, mode="linear", align_corners=False)[0]
