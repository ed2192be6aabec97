"""A picture in square cells, numbered row by row; those at its right and lower edge may be cut off."""

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

CELL_PX = 8  # per side


def grid(height: int, width: int) -> tuple[int, int]:
    """Rows and columns of cells in a picture of this size."""
    return -(-height // CELL_PX), -(-width // CELL_PX)


def cell_of_pixels(picture: Float[Tensor, "h w"]) -> Int[Tensor, "h w"]:
    """The cell of each pixel of such a picture."""
    _, columns = grid(*picture.shape)
    y, x = (torch.arange(side, device=picture.device) // CELL_PX for side in picture.shape)
    return y[:, None] * columns + x


def cell_sums(values: Float[Tensor, "h w c"]) -> Float[Tensor, "cells c"]:
    """The sums of the values in each cell."""
    height, width, channels = values.shape
    rows, columns = grid(height, width)
    whole = F.pad(values, (0, 0, 0, columns * CELL_PX - width, 0, rows * CELL_PX - height))
    return whole.view(rows, CELL_PX, columns, CELL_PX, channels).sum(dim=(1, 3)).view(rows * columns, channels)
