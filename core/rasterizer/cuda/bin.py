"""Tile lists: which Gaussians touch which tile, front to back, ties by index.

Two stages, with small keys. The depths (32 bits) of all Gaussians are sorted once. In that order they write which tiles
they touch, one pair per slot; a stable sort of the slots by tile (16 bits, for pictures of up to 8 megapixels) then
keeps the order of depth within each tile. (tile, depth) pairs of 64 bits would take three times the passes.

The slots of a Gaussian are neighbours, so that what tiles write to their slots can be added up a Gaussian at a time.
"""

from dataclasses import dataclass

import torch
import triton
import triton.language as tl
from torch import Tensor

from core.kernels.triton_launch import UNFUSED, blocks
from core.rasterizer import layout
from core.rasterizer.cuda import footprint
from core.rasterizer.cuda.footprint import touched_columns, touched_rows
from core.rasterizer.cuda.view import HEIGHT, WIDTH

BLOCK, WARPS = 32, 1  # Gaussians per program, one per thread: it takes as many rounds as the one with the most tiles
TILES_OF_16_BITS = 2**15 - 1


@dataclass
class TileLists:
    """The slots, numbered Gaussian by Gaussian, and the entries, which are the same pairs tile by tile, front to back.

    order: (N,) int64, the Gaussians front to back, those without a tile among or behind them.
    slot_starts: (N + 1,) int64: Gaussian order[p] has the slots slot_starts[p] to slot_starts[p + 1]. owners: (slots,)
    int32, the Gaussian of each slot.
    tile_starts: (tiles + 1,) int64: tile t has the entries tile_starts[t] to tile_starts[t + 1]. entry_slots: (slots,)
    int64, entry_splats: (slots,) int32, the slot and the Gaussian of each entry. Slots behind the last Gaussian's,
    where there is more room than was needed, belong to the tile behind the last one and, in name, to Gaussian 0.
    """

    order: Tensor
    slot_starts: Tensor
    owners: Tensor
    tile_starts: Tensor
    entry_slots: Tensor
    entry_splats: Tensor


@triton.jit(do_not_specialize=["count", "columns"])
def list_tiles(order, slot_starts, footprints, view, slot_tiles, owners, count, columns, BLOCK: tl.constexpr):
    """Write to the slots of each Gaussian the tiles that it touches, row by row, and its own index."""
    position = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    known = position < count
    slot = tl.load(slot_starts + position, mask=known, other=0)
    end = tl.load(slot_starts + position + 1, mask=known, other=0)
    drawn = known & (end > slot)
    splat = tl.load(order + position, mask=known, other=0)
    at = footprints + splat * footprint.COLUMNS
    x = tl.load(at + footprint.X, mask=drawn, other=0.0)
    y = tl.load(at + footprint.Y, mask=drawn, other=0.0)
    slope = tl.load(at + footprint.SLOPE, mask=drawn, other=0.0)
    half_height = tl.load(at + footprint.HALF_HEIGHT, mask=drawn, other=1.0)
    half_width = tl.load(at + footprint.HALF_WIDTH, mask=drawn, other=1.0)
    lean = tl.load(at + footprint.LEAN, mask=drawn, other=0.0)
    # By the functions that counted them: the slots are filled exactly.
    first_row, last_row = touched_rows(y, half_height, tl.load(view + HEIGHT))
    rows = tl.where(drawn, last_row - first_row, 0)
    most_rows = tl.max(rows, axis=0)
    step = 0
    while step < most_rows:
        tile_row = first_row + step
        first, last = touched_columns(x, y, slope, half_height, half_width, lean, tile_row, tl.load(view + WIDTH))
        touched = tl.where(step < rows, last - first, 0)
        most_columns = tl.max(touched, axis=0)
        further = 0
        while further < most_columns:
            inside = (further < touched) & (slot < end)
            tile = tile_row * columns + first + further
            tl.store(slot_tiles + slot, tile.to(slot_tiles.dtype.element_ty), mask=inside)
            tl.store(owners + slot, splat.to(tl.int32), mask=inside)
            slot += inside.to(tl.int64)
            further += 1
        step += 1


def front_to_back(depths: Tensor, tile_counts: Tensor) -> tuple[Tensor, Tensor]:
    """`order` and `slot_starts` of the lists, from depths (N,) and counts of tiles (N,)."""
    order = torch.sort(depths, stable=True).indices
    slot_starts = torch.zeros(len(depths) + 1, dtype=torch.int64, device=depths.device)
    torch.cumsum(tile_counts[order], dim=0, dtype=torch.int64, out=slot_starts[1:])
    return order, slot_starts


def tile_lists(
    order: Tensor, slot_starts: Tensor, footprints: Tensor, view: Tensor, width: int, height: int, slots: int
) -> TileLists:
    """The lists of a picture of `width` by `height` px; slots: their number, slot_starts[-1], or more."""
    columns, rows = layout.tiles_along(width), layout.tiles_along(height)
    tiles = columns * rows
    key = torch.int16 if tiles <= TILES_OF_16_BITS else torch.int32
    slot_tiles = torch.full((slots,), tiles, dtype=key, device=order.device)
    owners = torch.zeros(slots, dtype=torch.int32, device=order.device)
    list_tiles[blocks(len(order), BLOCK)](
        order, slot_starts, footprints, view, slot_tiles, owners, len(order), columns,
        BLOCK=BLOCK, num_warps=WARPS, **UNFUSED,
    )  # fmt: skip
    sorted_tiles, entry_slots = torch.sort(slot_tiles, stable=True)
    tile_starts = torch.searchsorted(sorted_tiles, torch.arange(tiles + 1, dtype=key, device=order.device))
    return TileLists(order, slot_starts, owners, tile_starts, entry_slots, owners[entry_slots])
