"""Gradients of the picture by the footprints, as core.rasterizer.cpu.blend_backward derives them."""

import triton
import triton.language as tl

from core.rasterizer import layout
from core.rasterizer.cuda.blend import (
    ALPHA_MAX,
    PIXELS,
    blended,
    coverage,
    note_of,
    pixels_of,
    read_splat,
    section_length,
    splat_of,
)

WARPS = 1  # nine sums over a tile per splat: within one warp they need no barrier
LANES = tl.constexpr(32)

# Of a row of the slots' gradients.
SUM_G, SUM_GE, SUM_GEE = tl.constexpr(layout.SUM_G), tl.constexpr(layout.SUM_GE), tl.constexpr(layout.SUM_GEE)
SUM_GY, SUM_GEY, SUM_GYY = tl.constexpr(layout.SUM_GY), tl.constexpr(layout.SUM_GEY), tl.constexpr(layout.SUM_GYY)
SUM_RED, SUM_GREEN = tl.constexpr(layout.SUM_RED), tl.constexpr(layout.SUM_GREEN)
SUM_BLUE = tl.constexpr(layout.SUM_BLUE)
SLOT_COLUMNS = tl.constexpr(layout.SLOT_COLUMNS)

BLOCK = 4  # Gaussians per program of `add_up`, whose loads hide each other's waiting
SLOTS_AT_ONCE = tl.constexpr(8)  # of each; few touch more tiles
PADDED_COLUMNS = tl.constexpr(16)  # Triton's tensors have powers of two


@triton.jit(do_not_specialize=["sections", "columns", "width", "height"])
def blend_backward(
    tile_starts, part_ends, notes, entry_splats, entry_slots, footprints,
    image, image_gradient, slot_gradients, blended_slots,
    sections, columns, width, height, PARTS: tl.constexpr, NOTES: tl.constexpr,
):  # fmt: skip
    """Write the gradients (slots, SLOT_COLUMNS) of the slots that the forward pass blended in a section of a
    tile's list, from dL/d(image), and which these are.

    part_ends, notes: as the forward pass left them. blended_slots: zeros (slots,) uint8, to become 1 there; the
    gradients of the others are left as they are.
    """
    tile, section = tl.program_id(0), tl.program_id(1)
    pixel = tl.arange(0, PIXELS)
    x, y, offset, inside = pixels_of(tile, pixel, columns, width, height)
    lane = tl.arange(0, LANES)
    column, stores = column_of(lane)
    v_red = tl.load(image_gradient + 3 * offset, mask=inside, other=0.0)
    v_green = tl.load(image_gradient + 3 * offset + 1, mask=inside, other=0.0)
    v_blue = tl.load(image_gradient + 3 * offset + 2, mask=inside, other=0.0)
    behind = tl.load(image + 3 * offset, mask=inside, other=0.0) * v_red
    behind += tl.load(image + 3 * offset + 1, mask=inside, other=0.0) * v_green
    behind += tl.load(image + 3 * offset + 2, mask=inside, other=0.0) * v_blue
    entry, end = tl.load(tile_starts + tile), tl.load(part_ends + tile * PARTS)
    for part in tl.static_range(1, PARTS):
        end = tl.maximum(end, tl.load(part_ends + tile * PARTS + part))
    if NOTES:
        length = section_length(tl.load(tile_starts + tile + 1) - entry, sections)
        entry += section * length
        end = tl.minimum(end, entry + length)
        unfinished = entry < tl.load(part_ends + tile * PARTS + pixel // (PIXELS // PARTS))
        note = notes + note_of(tile, section, sections, pixel)
        light = tl.load(note, mask=unfinished, other=-1.0)
        behind -= tl.load(note + PIXELS, mask=unfinished, other=0.0) * v_red
        behind -= tl.load(note + 2 * PIXELS, mask=unfinished, other=0.0) * v_green
        behind -= tl.load(note + 3 * PIXELS, mask=unfinished, other=0.0) * v_blue
    else:
        light = tl.where(inside, 1.0, -1.0)
    v = v_red, v_green, v_blue
    this, other = splat_of(entry_splats, entry, end), splat_of(entry_splats, entry + 1, end)
    shape, colour = read_splat(footprints, this, entry < end)
    while entry < end:
        other_exists = entry + 1 < end
        slot, other_slot = tl.load(entry_slots + entry), tl.load(entry_slots + entry + 1, mask=other_exists, other=0)
        other_shape, other_colour = read_splat(footprints, other, other_exists)
        this = splat_of(entry_splats, entry + 2, end)
        total, light, behind = sums_of(shape, colour, v, light, behind, x, y, lane)
        tl.store(slot_gradients + slot * SLOT_COLUMNS + column, total, mask=stores)
        tl.store(blended_slots + slot, 1)
        shape, colour = read_splat(footprints, this, entry + 2 < end)
        other = splat_of(entry_splats, entry + 3, end)
        total, light, behind = sums_of(other_shape, other_colour, v, light, behind, x, y, lane)
        tl.store(slot_gradients + other_slot * SLOT_COLUMNS + column, total, mask=stores & other_exists)
        tl.store(blended_slots + other_slot, 1, mask=other_exists)
        entry += 2


@triton.jit
def sums_of(shape, colour, v, light, behind, x, y, lane):
    """A splat's sums over the pixels, as `over_pixels` has them; the light behind it, and S of what lies behind it.

    v: the picture's gradient. behind: S before the splat.
    """
    unclamped, e, dy = coverage(shape, x, y)
    alpha = tl.minimum(unclamped, ALPHA_MAX)
    shown, weight, light, let_through = blended(light, alpha)
    pull = v[0] * colour[0]
    pull += v[1] * colour[1]
    pull += v[2] * colour[2]
    behind -= weight * pull
    # alpha dL/d alpha = w (v . c) - S alpha / (1 - alpha); nothing where alpha was clamped. A division takes eight
    # instructions, most of them for what lies beyond 1e-38 and 1e38.
    inverse_root = tl.rsqrt(let_through)
    g = weight * pull - behind * shown * (inverse_root * inverse_root)
    g = tl.where(unclamped <= ALPHA_MAX, g, 0.0)
    ge, gy = g * e, g * dy
    return (
        over_pixels(g, ge, ge * e, gy, gy * e, gy * dy, weight * v[0], weight * v[1], weight * v[2], lane),
        light,
        behind,
    )


@triton.jit
def over_pixels(g, ge, gee, gy, gey, gyy, red, green, blue, lane):
    """The sums over all pixels, each in the lanes for which `column_of` says so, in this order, which is the slots'.

    At every halving of the warp a lane keeps one value of two and hands on the other: twelve shuffles, where nine sums
    by themselves take 45.
    """
    g, ge, gee = over_rows(g), over_rows(ge), over_rows(gee)
    gy, gey, gyy = over_rows(gy), over_rows(gey), over_rows(gyy)
    red, green, blue = over_rows(red), over_rows(green), over_rows(blue)
    first, second = halved(g, ge, lane, 16), halved(gee, gy, lane, 16)
    third, fourth = halved(gey, gyy, lane, 16), halved(red, green, lane, 16)
    half, other_half = halved(first, second, lane, 8), halved(third, fourth, lane, 8)
    blue = crossed(crossed(crossed(blue, lane, 16), lane, 8), lane, 4)
    return crossed(halved(halved(half, other_half, lane, 4), blue, lane, 2), lane, 1)


@triton.jit
def over_rows(values):
    """What the pixels hold, summed over those of each lane."""
    return tl.sum(tl.reshape(values, (PIXELS // LANES, LANES)), axis=0)


@triton.jit
def column_of(lane):
    """Which of the nine sums of `over_pixels` a lane ends up with, and whether it is the one lane that stores it."""
    is_last = lane & 2 != 0
    column = tl.where(is_last, SLOT_COLUMNS - 1, (lane >> 4 & 1) + (lane >> 3 & 1) * 2 + (lane >> 2 & 1) * 4)
    return column, (lane & 1 == 0) & ((lane & 2 == 0) | (lane & 28 == 0))


@triton.jit
def halved(first, second, lane, BIT: tl.constexpr):
    """Sums over the two lanes that differ in BIT: of `first` in the lane without it, of `second` in the other."""
    upper = lane & BIT != 0
    return tl.where(upper, second, first) + crossing(tl.where(upper, first, second), lane, BIT)


@triton.jit
def crossed(values, lane, BIT: tl.constexpr):
    """Sums over the two lanes that differ in BIT, in both."""
    return values + crossing(values, lane, BIT)


@triton.jit
def crossing(values, lane, BIT: tl.constexpr):
    """What the lane holds whose number differs from this one's in BIT alone."""
    return tl.gather(values, lane ^ BIT, axis=0)


@triton.jit(do_not_specialize=["count"])
def add_up(order, slot_starts, slot_gradients, blended_slots, sums, count, BLOCK: tl.constexpr):
    """Sum the slots of each Gaussian that were blended, always in the same order,
    into its row of sums (N, SLOT_COLUMNS)."""
    position = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    known = position < count
    splat = tl.load(order + position, mask=known, other=0)
    slot = tl.load(slot_starts + position, mask=known, other=0)
    slots = tl.load(slot_starts + position + 1, mask=known, other=0) - slot
    most = tl.max(slots, axis=0)
    column = tl.arange(0, PADDED_COLUMNS)[None, None, :]
    total = tl.zeros((BLOCK, PADDED_COLUMNS), dtype=tl.float32)
    done = tl.zeros_like(most)
    while done < most:
        number = done + tl.arange(0, SLOTS_AT_ONCE)[None, :, None]
        at = slot[:, None, None] + number
        there = number < slots[:, None, None]
        there &= tl.load(blended_slots + at, mask=there, other=0) != 0
        part = tl.load(slot_gradients + at * SLOT_COLUMNS + column, mask=there & (column < SLOT_COLUMNS), other=0.0)
        total += tl.sum(part, axis=1)
        done += SLOTS_AT_ONCE
    column = tl.arange(0, PADDED_COLUMNS)[None, :]
    tl.store(sums + splat[:, None] * SLOT_COLUMNS + column, total, mask=known[:, None] & (column < SLOT_COLUMNS))
