"""Gradients of the picture by the footprints: the forward pass once more, with two numbers of state per pixel, T and S
(`light` and `behind`).

With C(p) the picture including its background, v = dL/dC and c_i the colours, let S_i = v . (what splats i + 1, ... and
the background add to the pixel). Going front to back, S starts as v . C and loses w_i (v . c_i) at each splat, and

    dL/d alpha_i = T_i (v . c_i) - S_i / (1 - alpha_i),      w_i = alpha_i T_i

so that any number of channels costs one dot product, and nothing has to be stored per splat and pixel.
"""

import numpy as np

from core.kernels.compiled import exact_kernel, exact_part
from core.kernels.simd import (
    LANES,
    broadcast,
    fetch_add,
    lane_sum,
    lane_sums,
    load,
    lowest_set_bit,
    multiply_add,
    prefetch,
    select,
    store,
)
from core.rasterizer import layout
from core.rasterizer.cpu.bin import SLOT, SPLAT
from core.rasterizer.cpu.blend import (
    ALPHA_LIMIT,
    BATCH,
    CHUNKS,
    OFFSETS,
    ONE,
    ROW_TERMS,
    ZERO,
    alpha_in_chunk,
    blended,
    clamped,
    write_row_terms,
)
from core.rasterizer.cpu.footprint import tiles_along
from core.rasterizer.layout import TILE

# What a chunk keeps: transmittances (negative when finished, as in the forward pass), S, and the three gradients v.
BEHIND, RED, GREEN, BLUE = LANES, 2 * LANES, 3 * LANES, 4 * LANES
STATE = 5 * LANES


@exact_kernel
def blend_backward(
    taken, first, step, tile_starts, entries, footprints, drawn_chunks, image, image_gradient, slot_gradients,
):  # fmt: skip
    """Write the slots' gradients (slots, SLOT_COLUMNS) wherever drawn_chunks (slots,) is not zero, from dL/d(image).

    Takes tiles as `blend_forward` does.
    """
    columns = tiles_along(image.shape[1])
    state = np.empty(CHUNKS * STATE, np.float32)
    terms = np.empty(BATCH * ROW_TERMS, np.float32)
    moments = np.empty(LANES, np.float32)
    for number in range(len(taken)):
        tile = (first + step * number) % len(taken)
        if fetch_add(taken, tile, 1) != 0:
            continue
        left, top = (tile % columns) * TILE, (tile // columns) * TILE
        centre_x, centre_y = np.float32(left + TILE / 2), np.float32(top + TILE / 2)
        read_tile(state, left, top, image, image_gradient)
        for begin in range(tile_starts[tile], tile_starts[tile + 1], BATCH):
            end = min(begin + BATCH, tile_starts[tile + 1])
            for entry in range(begin, end):
                # As in the forward pass; here a third of the time, as the slots are jumped about in as well.
                ahead = min(entry + BATCH, len(entries) - 1)
                prefetch(footprints, entries[ahead, SPLAT] * layout.FOOTPRINT_COLUMNS)
                prefetch(drawn_chunks, entries[ahead, SLOT])
                prefetch(slot_gradients, entries[ahead, SLOT] * layout.SLOT_COLUMNS)
                at = (entry - begin) * ROW_TERMS
                write_row_terms(footprints, entries[entry, SPLAT], centre_x, centre_y, terms, at)
            for entry in range(begin, end):
                i, slot = entries[entry, SPLAT], entries[entry, SLOT]
                if drawn_chunks[slot] != 0:
                    at = (entry - begin) * ROW_TERMS
                    slot_gradients[slot, layout.SUM_BLUE] = gather_moments(
                        drawn_chunks[slot], footprints, i, terms, at, state, moments
                    )
                    move_moments(moments, footprints, i, centre_x, centre_y, slot_gradients, slot)


@exact_part
def read_tile(state, left, top, image, image_gradient):
    """The state before the first splat; pixels outside the picture are finished from the start."""
    height, width = image.shape[0], image.shape[1]
    state[:] = 0
    for chunk in range(CHUNKS):
        y, first_x = top + chunk % TILE, left + chunk // TILE * LANES
        for lane in range(LANES):
            here, x = chunk * STATE + lane, first_x + lane
            if x < width and y < height:
                red, green, blue = image_gradient[y, x, 0], image_gradient[y, x, 1], image_gradient[y, x, 2]
                state[here] = 1.0
                state[here + BEHIND] = image[y, x, 0] * red + image[y, x, 1] * green + image[y, x, 2] * blue
                state[here + RED], state[here + GREEN], state[here + BLUE] = red, green, blue
            else:
                state[here] = -1.0


@exact_part
def gather_moments(chunks, footprints, i, terms, at, state, moments):
    """Splat `i`'s sums over the tile of g x^m y^n, x and y from the tile's centre, and of w v.

    moments becomes g, g x, g x^2, g y, g x y, g y^2, w v_red, w v_green; the last, w v_blue, is returned.
    """
    sharpness = broadcast(footprints[i, layout.SHARPNESS])
    red = broadcast(footprints[i, layout.RED])
    green = broadcast(footprints[i, layout.GREEN])
    blue = broadcast(footprints[i, layout.BLUE])
    zero, one = broadcast(ZERO), broadcast(ONE)
    sum_g, sum_x, sum_xx, sum_y, sum_xy, sum_yy = zero, zero, zero, zero, zero, zero
    sum_red, sum_green, sum_blue = zero, zero, zero
    while chunks != 0:
        chunk = lowest_set_bit(chunks)
        chunks &= chunks - np.uint32(1)
        here = chunk * STATE
        light = load(state, here)
        unclamped = alpha_in_chunk(chunk, sharpness, terms, at)
        alpha = clamped(unclamped)
        goes_on, weight, light = blended(light, alpha)
        store(state, here, light)

        v_red, v_green, v_blue = load(state, here + RED), load(state, here + GREEN), load(state, here + BLUE)
        sum_red = multiply_add(weight, v_red, sum_red)
        sum_green = multiply_add(weight, v_green, sum_green)
        sum_blue = multiply_add(weight, v_blue, sum_blue)
        pull = multiply_add(v_red, red, multiply_add(v_green, green, v_blue * blue))
        behind = load(state, here + BEHIND) - weight * pull
        store(state, here + BEHIND, behind)

        # alpha dL/d alpha = w (v . c) - S alpha / (1 - alpha); nothing where alpha was clamped. 1 - alpha >= 0.01.
        g = weight * pull - behind * alpha / (one - alpha)
        g = select(goes_on, select(broadcast(ALPHA_LIMIT) >= unclamped, g, zero), zero)
        x, y = load(OFFSETS, (chunk >> 4) * LANES), broadcast(OFFSETS[chunk & (TILE - 1)])
        g_x, g_y = g * x, g * y
        sum_g, sum_x, sum_y = sum_g + g, sum_x + g_x, sum_y + g_y
        sum_xx = multiply_add(g_x, x, sum_xx)
        sum_xy = multiply_add(g_x, y, sum_xy)
        sum_yy = multiply_add(g_y, y, sum_yy)
    store(moments, 0, lane_sums(sum_g, sum_x, sum_xx, sum_y, sum_xy, sum_yy, sum_red, sum_green))
    return lane_sum(sum_blue)


@exact_part
def move_moments(moments, footprints, i, centre_x, centre_y, slot_gradients, slot):
    """Moments about the tile's centre, which are small, to moments in (e, dy) about the splat's line and centre.

    In float64: far from the splat's centre the terms are larger than their sum.
    """
    slope = np.float64(footprints[i, layout.SLOPE])
    to_y = np.float64(centre_y) - footprints[i, layout.Y]
    to_e = np.float64(centre_x) - footprints[i, layout.X] - slope * to_y
    g, g_x, g_xx = np.float64(moments[0]), np.float64(moments[1]), np.float64(moments[2])
    g_y, g_xy, g_yy = np.float64(moments[3]), np.float64(moments[4]), np.float64(moments[5])
    # First shear x to x - slope y, then shift by (to_e, to_y).
    sheared, sheared_y = g_x - slope * g_y, g_xy - slope * g_yy
    sheared_2 = g_xx - 2 * slope * g_xy + slope * slope * g_yy
    slot_gradients[slot, layout.SUM_G] = g
    slot_gradients[slot, layout.SUM_GE] = sheared + to_e * g
    slot_gradients[slot, layout.SUM_GEE] = sheared_2 + to_e * (2 * sheared + to_e * g)
    slot_gradients[slot, layout.SUM_GY] = g_y + to_y * g
    slot_gradients[slot, layout.SUM_GEY] = sheared_y + to_e * g_y + to_y * (sheared + to_e * g)
    slot_gradients[slot, layout.SUM_GYY] = g_yy + to_y * (2 * g_y + to_y * g)
    slot_gradients[slot, layout.SUM_RED] = moments[6]
    slot_gradients[slot, layout.SUM_GREEN] = moments[7]
