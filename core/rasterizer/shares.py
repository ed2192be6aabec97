"""A picture's cells (core.scene.cells) as a linear map of the Gaussians' colours.

Whoever compares many looks with one photo projects, sorts and blends once: what a cell shows of a Gaussian is the same in every look.
"""

from collections.abc import Callable

import scipy.sparse
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from core.scene.camera import Camera
from core.scene.cells import cell_of_pixels, grid

TILE_CELLS = 2  # a side of the tiles that both backends of kernels draw in


class Mixture:
    """The product of a sparse matrix such as `Rasterizer.shares` gives with colours. On a CPU by scipy: torch's takes ten times as long."""

    def __init__(self, shares: Float[Tensor, "cells n"]):
        self.shares = shares
        self.on_cpu = shares.device.type == "cpu"
        if self.on_cpu:
            matrix = scipy.sparse.coo_array((shares.values().numpy(), tuple(shares.indices().numpy())), shape=shares.shape)
            self.matrix, self.transposed = matrix.tocsr(), matrix.T.tocsr()

    def __call__(self, colours: Float[Tensor, "n c"]) -> Float[Tensor, "cells c"]:
        """What the cells show, summed over their pixels; differentiable."""
        return _Product.apply(self, colours) if self.on_cpu else torch.sparse.mm(self.shares, colours)

    def of_gaussians(self) -> Float[Tensor, " n"]:
        """How many pixels each Gaussian makes up, over all cells."""
        return self.shares.sum(dim=0).to_dense()


class _Product(torch.autograd.Function):
    @staticmethod
    def forward(ctx, mixture: Mixture, colours: Tensor) -> Tensor:
        ctx.mixture = mixture
        return torch.from_numpy(mixture.matrix @ colours.numpy())

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient: Tensor):
        return None, torch.from_numpy(ctx.mixture.transposed @ gradient.numpy())


def shares_of_slots(
    camera: Camera,
    weight: Float[Tensor, "h w"],
    count: int,
    owners: Int[Tensor, " slots"],
    tiles: Int[Tensor, " slots"],
    colour_gradients: Callable[[Float[Tensor, "h w 3"]], Float[Tensor, "slots 3"]],
) -> Float[Tensor, "cells n"]:
    """`Rasterizer.shares` from slots, each of one Gaussian in one tile of TILE_CELLS x TILE_CELLS cells.

    owners, tiles: of the slots. count: n. colour_gradients: the gradients of the slots' colours by those of the picture. As a picture is
    linear in the colours, these are sums of shares. Each channel asks for one quarter of all tiles.
    """
    _, columns = grid(camera)
    tiles_across = -(-columns // TILE_CELLS)
    cells = cell_of_pixels(camera, weight.device)
    quarters = cells // columns % TILE_CELLS * TILE_CELLS + cells % columns % TILE_CELLS
    indices, values = [], []
    for first in range(0, TILE_CELLS**2, 3):
        channels = torch.arange(first, first + 3, device=weight.device)
        sums = colour_gradients(weight[..., None] * (quarters[..., None] == channels))
        for channel, quarter in enumerate(channels[channels < TILE_CELLS**2].tolist()):
            slots = sums[:, channel].nonzero()[:, 0]
            row, column = (TILE_CELLS * at + of for at, of in zip(_divmod(tiles[slots], tiles_across), divmod(quarter, TILE_CELLS)))
            indices.append(torch.stack([row * columns + column, owners[slots].long()]))
            values.append(sums[slots, channel])
    return sparse(torch.cat(indices, dim=1), torch.cat(values), camera, count)


def sparse(indices: Int[Tensor, "2 k"], values: Float[Tensor, " k"], camera: Camera, count: int) -> Float[Tensor, "cells n"]:
    """The sparse matrix of these shares; indices: cell and Gaussian of each."""
    rows, columns = grid(camera)
    return torch.sparse_coo_tensor(indices, values, (rows * columns, count), check_invariants=True).coalesce()


def _divmod(numbers: Tensor, by: int) -> tuple[Tensor, Tensor]:
    return numbers // by, numbers % by
