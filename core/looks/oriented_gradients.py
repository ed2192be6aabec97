"""Dense features: the histograms of oriented gradients (Dalal & Triggs 2005) around the points of a grid.

Light changes them little: they know neither the brightness nor the sign of an edge.
"""

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

GRID_PX = 4  # between neighbouring points
ORIENTATIONS = 8  # of edges, over half a turn
CELL_PX, CELLS = 6, 4  # a point's surroundings: CELLS x CELLS histograms, this far apart
CELL_WEIGHTS = 1, 2, 3, 3, 3, 3, 2, 1  # of the pixels of such a cell, in a row or column
FLAT = 0.002  # mean gradient of what shows nothing: half an 8-bit step per pixel
LUMA = 0.299, 0.587, 0.114  # of red, green and blue


@dataclass(frozen=True)
class GridFeatures:
    """The features of a picture at points GRID_PX apart. descriptors: of unit length, but zero where it is flat.
    rows, columns: the pixels that the points lie in."""

    descriptors: Float[Tensor, "d r c"]
    rows: Int[np.ndarray, " r"]
    columns: Int[np.ndarray, " c"]

    @staticmethod
    def of(picture: Float[Tensor, "h w 3"]) -> "GridFeatures":
        """Those of a picture, [0, 1], on the CPU."""
        luma = picture @ picture.new_tensor(LUMA)
        padded = F.pad(luma[None, None], (1, 1, 1, 1), mode="replicate")[0, 0]
        x, y = padded[1:-1, 2:] - padded[1:-1, :-2], padded[2:, 1:-1] - padded[:-2, 1:-1]
        strength = (x**2 + y**2).sqrt()
        angle = torch.atan2(y, x) % torch.pi / torch.pi * ORIENTATIONS
        lower = angle.floor()
        histograms = strength.new_zeros(ORIENTATIONS, *luma.shape)
        for offset, share in ((0, 1 - (angle - lower)), (1, angle - lower)):
            histograms.scatter_add_(0, (lower.long()[None] + offset) % ORIENTATIONS, (strength * share)[None])
        return GridFeatures._around(histograms)

    @staticmethod
    def _around(histograms: Float[Tensor, "o h w"]) -> "GridFeatures":
        """Of the histogram of each pixel: weighted means over cells, by root and without their mean
        (Arandjelovic & Zisserman 2012), of unit length."""
        height, width = histograms.shape[1:]
        reach, weights = CELLS * CELL_PX // 2, histograms.new_tensor(CELL_WEIGHTS) / sum(CELL_WEIGHTS)
        padding = len(weights) // 2 + reach
        cells = F.conv2d(histograms[:, None], weights.view(1, 1, -1, 1), padding=(padding, 0))
        cells = F.conv2d(cells, weights.view(1, 1, 1, -1), padding=(0, padding))[:, 0]
        offsets = [round((number - (CELLS - 1) / 2) * CELL_PX) + reach for number in range(CELLS)]
        down, right = (
            [slice(GRID_PX // 2 + offset, side + offset, GRID_PX) for offset in offsets] for side in (height, width)
        )
        around = torch.cat([cells[:, *each] for each in product(down, right)])
        is_flat = around.sum(dim=0) < FLAT * CELLS**2
        rooted = around.sqrt()
        rooted = rooted - rooted.mean(dim=0)
        rows, columns = (np.arange(GRID_PX // 2, side, GRID_PX) for side in (height, width))
        return GridFeatures(F.normalize(rooted, dim=0).masked_fill(is_flat, 0), rows, columns)

    @property
    def pixels(self) -> Float[np.ndarray, "n 2"]:
        """The centres of the pixels that the points lie in, row by row: x, y."""
        x, y = np.meshgrid(self.columns + 0.5, self.rows + 0.5)
        return np.stack([x.ravel(), y.ravel()], axis=1)

    def only(self, use: Bool[np.ndarray, "h w"]) -> "GridFeatures":
        """The same, but as if it were flat where the picture is not to be used."""
        used = torch.from_numpy(use[np.ix_(self.rows, self.columns)])
        return GridFeatures(self.descriptors * used, self.rows, self.columns)


class Pairs(NamedTuple):
    """Which point of one grid matches which of another: indices, row by row.
    offset: where beside its own point the first grid shows what the second shows at the other, px (x, y)."""

    first: Int[np.ndarray, " m"]
    second: Int[np.ndarray, " m"]
    offset: Float[np.ndarray, "m 2"]


def matches(first: GridFeatures, second: GridFeatures) -> Pairs:
    """Points that are most similar to each other, of all."""
    similar = first.descriptors.flatten(1).T @ second.descriptors.flatten(1)
    if not similar.numel():  # of a picture a few pixels high
        return Pairs(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)))
    (best, there), back = similar.max(dim=1), similar.max(dim=0).indices
    own = ((back[there] == torch.arange(len(there))) & (best > 0)).nonzero()[:, 0]
    return Pairs(own.numpy(), there[own].numpy(), np.zeros((len(own), 2)))


def coherence(pairs: Pairs, first: GridFeatures, second: GridFeatures) -> int:
    """How many neighbouring points of the first grid match points of the second that lie beside each other as they do,
    to within one row and column: by chance, few (Bian et al. 2017: grid-based motion statistics)."""
    places = np.full((len(first.rows), len(first.columns), 2), np.nan)
    places.reshape(-1, 2)[pairs.first] = np.stack(np.divmod(pairs.second, len(second.columns)), axis=1)
    down, right = np.diff(places, axis=0) - (1, 0), np.diff(places, axis=1) - (0, 1)
    return sum(int((abs(each) <= 1).all(axis=2).sum()) for each in (down, right))


def matches_nearby(first: GridFeatures, second: GridFeatures, reach: int, least: float) -> Pairs:
    """Points that are most similar to each other, of those at most `reach` rows and columns away,
    with a cosine of more than `least`. Both grids are equally large."""
    height, width = first.descriptors.shape[1:]
    side = 2 * reach + 1
    steps = torch.cartesian_prod(*[torch.arange(-reach, reach + 1)] * 2)  # down, right
    windows = [
        (slice(reach + down, reach + down + height), slice(reach + right, reach + right + width))
        for down, right in steps.tolist()
    ]
    others = F.pad(second.descriptors, (reach,) * 4)
    similar = torch.stack([(first.descriptors * others[:, *window]).sum(dim=0) for window in windows])
    # The same numbers, as the points of the second see them: each step leads the other way.
    seen_back = F.pad(similar, (reach,) * 4)
    back = torch.stack([seen_back[-1 - number, *window] for number, window in enumerate(windows)])
    best, chosen = similar.flatten(1).max(dim=0)
    there = torch.cartesian_prod(torch.arange(height), torch.arange(width)) + steps[chosen]
    inside = ((there >= 0) & (there < torch.tensor([height, width]))).all(dim=1)
    there = torch.where(inside, there[:, 0] * width + there[:, 1], 0)
    returned = back.flatten(1).argmax(dim=0)[there] == side**2 - 1 - chosen
    own = (inside & returned & (best > least)).nonzero()[:, 0]
    offset = _peaks(similar.view(side, side, -1)[..., own], chosen[own]) * -GRID_PX
    return Pairs(own.numpy(), there[own].numpy(), offset.numpy())


def _peaks(similar: Float[Tensor, "s s m"], chosen: Int[Tensor, " m"]) -> Float[Tensor, "m 2"]:
    """How far beside the chosen steps, (x, y) in steps, parabolas through their neighbours peak; 0 at the rim."""
    side, rows = len(similar), torch.arange(similar.shape[2])
    down, right = chosen // side, chosen % side
    offsets = []
    for y, x in ((0, 1), (1, 0)):
        before, at, after = (
            similar[(down + way * y).clamp(0, side - 1), (right + way * x).clamp(0, side - 1), rows]
            for way in (-1, 0, 1)
        )
        curve = 2 * at - before - after
        place = x * right + y * down
        inner = (place > 0) & (place < side - 1) & (curve > 0)
        offsets.append(torch.where(inner, (after - before) / (2 * curve.clamp_min(1e-9)), 0.0))
    return torch.stack(offsets, dim=1)
