"""Gradients of the picture by the footprints, as core.rasterizer.cpu.blend_backward derives them."""

import triton
import triton.language as tl

from core.rasterizer import layout
from core.rasterizer.cuda import footprint
from core.rasterizer.cuda.blend import ALPHA_MAX, blended, coverage, pixels_of

WARPS = 1  # nine sums over a tile a splat: within one warp they need no barrier

# Of a row of the slots' gradients.
SUM_G, SUM_GE, SUM_GEE = tl.constexpr(layout.SUM_G), tl.constexpr(layout.SUM_GE), tl.constexpr(layout.SUM_GEE)
SUM_GY, SUM_GEY, SUM_GYY = tl.constexpr(layout.SUM_GY), tl.constexpr(layout.SUM_GEY), tl.constexpr(layout.SUM_GYY)
SUM_RED, SUM_GREEN, SUM_BLUE = tl.constexpr(layout.SUM_RED), tl.constexpr(layout.SUM_GREEN), tl.constexpr(layout.SUM_BLUE)
SLOT_COLUMNS = tl.constexpr(layout.SLOT_COLUMNS)

SLOTS_AT_ONCE = tl.constexpr(8)  # of one Gaussian, in `add_up`; few touch more tiles
PADDED_COLUMNS = tl.constexpr(16)  # Triton's tensors have powers of two


@triton.jit(do_not_specialize=["columns", "width", "height"])
def blend_backward(
    tile_starts, tile_ends, entry_splats, entry_slots, footprints, image, image_gradient, slot_gradients,
    columns, width, height,
):  # fmt: skip
    """Write the gradients (slots, SLOT_COLUMNS) of the slots that the forward pass blended, from dL/d(image)."""
    tile = tl.program_id(0)
    x, y, place, inside = pixels_of(tile, columns, width, height)
    light = tl.where(inside, 1.0, -1.0)
    v_red = tl.load(image_gradient + 3 * place, mask=inside, other=0.0)
    v_green = tl.load(image_gradient + 3 * place + 1, mask=inside, other=0.0)
    v_blue = tl.load(image_gradient + 3 * place + 2, mask=inside, other=0.0)
    behind = tl.load(image + 3 * place, mask=inside, other=0.0) * v_red
    behind += tl.load(image + 3 * place + 1, mask=inside, other=0.0) * v_green
    behind += tl.load(image + 3 * place + 2, mask=inside, other=0.0) * v_blue
    entry, end = tl.load(tile_starts + tile), tl.load(tile_ends + tile)
    while entry < end:
        splat = tl.load(entry_splats + entry)
        unclamped, e, dy = coverage(footprints, splat, x, y)
        alpha = tl.minimum(unclamped, ALPHA_MAX)
        goes_on, weight, light = blended(light, alpha)
        at = footprints + splat * footprint.COLUMNS
        pull = v_red * tl.load(at + footprint.RED)
        pull += v_green * tl.load(at + footprint.GREEN)
        pull += v_blue * tl.load(at + footprint.BLUE)
        behind -= weight * pull
        # alpha dL/d alpha = w (v . c) - S alpha / (1 - alpha); nothing where alpha was clamped. 1 - alpha >= 0.01.
        g = weight * pull - behind * alpha / (1.0 - alpha)
        g = tl.where(goes_on & (unclamped <= ALPHA_MAX), g, 0.0)
        ge, gy = g * e, g * dy
        to_slot = slot_gradients + tl.load(entry_slots + entry) * SLOT_COLUMNS
        tl.store(to_slot + SUM_G, tl.sum(g, axis=0))
        tl.store(to_slot + SUM_GE, tl.sum(ge, axis=0))
        tl.store(to_slot + SUM_GEE, tl.sum(ge * e, axis=0))
        tl.store(to_slot + SUM_GY, tl.sum(gy, axis=0))
        tl.store(to_slot + SUM_GEY, tl.sum(gy * e, axis=0))
        tl.store(to_slot + SUM_GYY, tl.sum(gy * dy, axis=0))
        tl.store(to_slot + SUM_RED, tl.sum(weight * v_red, axis=0))
        tl.store(to_slot + SUM_GREEN, tl.sum(weight * v_green, axis=0))
        tl.store(to_slot + SUM_BLUE, tl.sum(weight * v_blue, axis=0))
        entry += 1


@triton.jit
def add_up(order, slot_starts, slot_gradients, sums):
    """Sum the slots of one Gaussian, always in the same order, into its row of sums (N, SLOT_COLUMNS)."""
    position = tl.program_id(0)
    row, column = tl.arange(0, SLOTS_AT_ONCE)[:, None], tl.arange(0, PADDED_COLUMNS)[None, :]
    end = tl.load(slot_starts + position + 1)
    total = tl.zeros((PADDED_COLUMNS,), dtype=tl.float32)
    slot = tl.load(slot_starts + position)
    while slot < end:
        known = (slot + row < end) & (column < SLOT_COLUMNS)
        part = tl.load(slot_gradients + (slot + row) * SLOT_COLUMNS + column, mask=known, other=0.0)
        total += tl.sum(part, axis=0)
        slot += SLOTS_AT_ONCE
    column = tl.arange(0, PADDED_COLUMNS)
    splat = tl.load(order + position)
    tl.store(sums + splat * SLOT_COLUMNS + column, total, mask=column < SLOT_COLUMNS)
