"""A picture's cells (core.scene.cells) as a linear map of the Gaussians' colours.

To compare many looks with one photo, project, sort and blend once: how much of a Gaussian a cell shows is the same in
every look.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import scipy.sparse
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from core.rasterizer.layout import TILE, tiles_along
from core.scene.cells import CELL_PX, grid

TILE_CELLS = TILE // CELL_PX  # per side


@dataclass(frozen=True)
class Shares:
    """A sparse matrix of `shape` (cells, n), by its entries: the cell, the Gaussian, and how much of the cell it makes
    up, px: alpha T, summed over the cell's pixels as they are weighted."""

    cells: Int[Tensor, " k"]
    gaussians: Int[Tensor, " k"]
    values: Float[Tensor, " k"]
    shape: tuple[int, int]

    def mixed(self, colours: Float[Tensor, "n c"]) -> Float[Tensor, "cells c"]:
        """The matrix times colours: what the cells show, summed over their pixels. Differentiable in the colours."""
        if colours.device.type == "cpu":  # torch's own takes five times as long there
            return _Product.apply(self._matrices, colours)
        parts = self.values[:, None] * colours.index_select(0, self.gaussians)
        return colours.new_zeros(self.shape[0], colours.shape[1]).index_add(0, self.cells, parts)

    def of_cells(self) -> Float[Tensor, " cells"]:
        """How much of each cell all Gaussians make up, px."""
        return self.values.new_zeros(self.shape[0]).index_add_(0, self.cells, self.values)

    def of_gaussians(self) -> Float[Tensor, " n"]:
        """How much each Gaussian makes up of all cells, px."""
        return self.values.new_zeros(self.shape[1]).index_add_(0, self.gaussians, self.values)

    @cached_property
    def _matrices(self) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
        """The matrix and its transpose."""
        entries = self.values.numpy(), (self.cells.numpy(), self.gaussians.numpy())
        matrix = scipy.sparse.coo_array(entries, shape=self.shape)
        return matrix.tocsr(), matrix.T.tocsr()


class _Product(torch.autograd.Function):
    @staticmethod
    def forward(ctx, matrices, colours: Tensor) -> Tensor:
        matrix, ctx.transposed = matrices
        return torch.from_numpy(matrix @ colours.numpy())

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient: Tensor):
        return None, torch.from_numpy(ctx.transposed @ gradient.numpy())


def shares_of_slots(
    weight: Float[Tensor, "h w"],
    count: int,
    owners: Int[Tensor, " slots"],
    tiles: Int[Tensor, " slots"],
    colour_gradients: Callable[[Float[Tensor, "h w 3"]], Float[Tensor, "slots 3"]],
) -> Shares:
    """`Rasterizer.shares` from slots, each of one Gaussian in one tile of TILE_CELLS x TILE_CELLS cells.

    owners, tiles: of the slots. count: of all Gaussians. colour_gradients: the gradients of the slots' colours from
    that of the picture. As a picture is linear in the colours, these are sums of shares. Each channel asks for one cell
    of every tile, by its number within the tile.
    """
    rows, columns = grid(*weight.shape)
    tiles_across = tiles_along(weight.shape[1])
    y, x = (torch.arange(side, device=weight.device) // CELL_PX % TILE_CELLS for side in weight.shape)
    cell_in_tile = y[:, None] * TILE_CELLS + x
    found = []
    for first in range(0, TILE_CELLS**2, 3):
        cells = range(first, min(first + 3, TILE_CELLS**2))
        asked = weight.new_zeros(*weight.shape, 3)
        for channel, cell in enumerate(cells):
            asked[..., channel] = weight * (cell_in_tile == cell)
        sums = colour_gradients(asked)
        for channel, cell in enumerate(cells):
            slots = sums[:, channel].nonzero()[:, 0]
            row = TILE_CELLS * (tiles[slots] // tiles_across) + cell // TILE_CELLS
            column = TILE_CELLS * (tiles[slots] % tiles_across) + cell % TILE_CELLS
            found.append((row * columns + column, owners[slots].long(), sums[slots, channel]))
    entry_cells, entry_gaussians, values = map(torch.cat, zip(*found))
    return Shares(entry_cells, entry_gaussians, values, (rows * columns, count))
