"""What forward and backward blending share: a tile as chunks of eight pixels, and which chunks a splat touches.

A tile is 32 chunks: chunk k < 16 is the left half of row k, chunk 16 + k the right half. A set of chunks is an
integer with one bit each. Positions within a tile are measured from its centre.
"""

import numpy as np

from core.kernels.compiled import exact_part
from core.kernels.simd import (
    LANES,
    bits,
    broadcast,
    exp2,
    load,
    maximum,
    minimum,
    multiply_add,
    select,
    store,
)
from core.rasterizer import layout
from core.rasterizer.contract import ALPHA_MAX, LOG2_ALPHA_MIN, STOP_TRANSMITTANCE
from core.rasterizer.layout import TILE

CHUNKS = 2 * TILE
BATCH = 16  # splats whose chunk sets are found ahead, so that the branches on them are known when they come
LEAST_EXPONENT = np.float32(LOG2_ALPHA_MIN)
ALPHA_LIMIT = np.float32(ALPHA_MAX)
STOP = np.float32(STOP_TRANSMITTANCE)
ZERO, ONE = np.float32(0), np.float32(1)
# Rows of a tile from its centre; its left half's pixels and, eight further on, its right half's: the same sixteen
# numbers.
OFFSETS = np.arange(TILE, dtype=np.float32) - np.float32((TILE - 1) / 2)
HALF_TILE = np.float32(TILE / 2)
SPAN = np.float32(LANES - 1)  # px from the first pixel of a chunk to its last
ROW_TERMS = 2 * TILE  # floats per splat: see `write_row_terms`


@exact_part
def write_row_terms(footprints, i, centre_x, centre_y, terms, at):
    """Write what log2(alpha) = strength - (sharpness x + shift)^2 needs for each row, x from the tile's centre.

    terms[at : at + 16] become the shifts, the next sixteen the strengths. centre_x, centre_y: the tile's centre, px.
    """
    slope, sharpness = footprints[i, layout.SLOPE], footprints[i, layout.SHARPNESS]
    fall, strength = footprints[i, layout.FALL], footprints[i, layout.STRENGTH]
    to_x, to_y = centre_x - footprints[i, layout.X], centre_y - footprints[i, layout.Y]
    shift = broadcast(sharpness * (to_x - slope * to_y))
    lean = broadcast(-sharpness * slope)
    for half in range(2):
        rows = load(OFFSETS, half * LANES)
        dy = rows + broadcast(to_y)
        store(terms, at + half * LANES, multiply_add(lean, rows, shift))
        store(terms, at + TILE + half * LANES, multiply_add(broadcast(-fall) * dy, dy, broadcast(strength)))


@exact_part
def touched_chunks(sharpness, terms, at):
    """The chunks within which alpha reaches ALPHA_MIN, given the row terms: exact, no root, eight rows at a time."""
    chunks = np.uint32(0)
    for side in range(2):
        first = broadcast(sharpness * (OFFSETS[0] + side * HALF_TILE))
        for half in range(2):
            # sharpness x + shift grows with x, so over a chunk it is nearest to zero at an end, or is zero in between.
            at_first = load(terms, at + half * LANES) + first
            minus_at_last = broadcast(-sharpness * SPAN) - at_first
            nearest = maximum(maximum(at_first, minus_at_last), broadcast(ZERO))
            highest = load(terms, at + TILE + half * LANES) - nearest * nearest
            rows = bits(highest >= broadcast(LEAST_EXPONENT))
            chunks |= rows << np.uint32(side * TILE + half * LANES)
    return chunks


@exact_part
def alpha_in_chunk(chunk, sharpness, terms, at):
    """Alpha of a splat in the eight pixels of a chunk, before the clamp at ALPHA_MAX; 0 where it is below ALPHA_MIN."""
    row = at + (chunk & (TILE - 1))
    x = load(OFFSETS, (chunk >> 4) * LANES)
    shifted = multiply_add(sharpness, x, broadcast(terms[row]))
    exponent = broadcast(terms[row + TILE]) - shifted * shifted
    # The polynomial is nonsense for exponents below its range, which the selection throws away.
    return select(exponent >= broadcast(LEAST_EXPONENT), exp2(exponent), broadcast(ZERO))


@exact_part
def clamped(alpha):
    return minimum(alpha, broadcast(ALPHA_LIMIT))


@exact_part
def blended(light, alpha):
    """A splat over what is left of the light: (goes on, weight, the light behind it), eight pixels at a time.

    light is negative once its pixel is finished (or lies outside the picture), so that it then fails the test against
    STOP for good.
    """
    # Not light - alpha * light, which behind an opaque splat is a difference of nearly equal numbers.
    left_over = light * (broadcast(ONE) - alpha)
    goes_on = left_over >= broadcast(STOP)
    weight = select(goes_on, alpha * light, broadcast(ZERO))
    return goes_on, weight, select(goes_on, left_over, minimum(light, broadcast(ZERO) - light))
