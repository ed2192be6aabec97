"""Which tiles a footprint (core.rasterizer.layout) touches."""

import math

import numpy as np

from core.kernels.compiled import exact_part
from core.rasterizer import layout
from core.rasterizer.layout import HALF_HEIGHT, HALF_WIDTH, LEAN, SLOPE, TILE, X, Y

tiles_along = exact_part(layout.tiles_along)
SLACK_PX = 0.01  # for the rounding of centres far outside the picture: generous bounds cost a test, narrow ones a pixel


@exact_part
def touched_rows(footprints, i, height):
    """The tile rows [first, last) that hold pixel centres within the ellipse of footprint `i`."""
    y, half_height = np.float64(footprints[i, Y]), np.float64(footprints[i, HALF_HEIGHT])
    return tiles_between(y - half_height, y + half_height, height)


@exact_part
def touched_columns(footprints, i, tile_row, width):
    """The tiles [first, last) of a tile row that the ellipse touches: all of them, as an ellipse has no holes.

    From where it reaches furthest to the right its right border recedes on either side, so that within a band of rows
    it reaches furthest in the row nearest to that. The left is the mirror image.
    """
    x, y, slope = np.float64(footprints[i, X]), np.float64(footprints[i, Y]), np.float64(footprints[i, SLOPE])
    half_width, lean = np.float64(footprints[i, HALF_WIDTH]), np.float64(footprints[i, LEAN])
    inverse_height = 1.0 / np.float64(footprints[i, HALF_HEIGHT])
    top = tile_row * TILE + 0.5 - y
    bottom = top + (TILE - 1.0)
    right_row, left_row = min(max(lean, top), bottom), min(max(-lean, top), bottom)
    right = slope * right_row + half_width * half_chord(right_row * inverse_height)
    left = slope * left_row - half_width * half_chord(left_row * inverse_height)
    return tiles_between(x + left, x + right, width)


@exact_part
def half_chord(height):
    """Half the chord of the unit circle at a height above its centre; 0 outside."""
    return math.sqrt(max(1.0 - height * height, 0.0))


@exact_part
def tiles_between(low, high, size):
    """The tiles [first, last) along an axis of `size` pixels that hold pixel centres in [low, high] (px)."""
    # Clamped before it becomes an integer: the cast of a float beyond the integers' range is undefined.
    first_pixel = np.int64(math.ceil(min(max(low - SLACK_PX - 0.5, 0.0), size + 0.0)))
    last_pixel = np.int64(math.floor(min(max(high + SLACK_PX - 0.5, -1.0), size - 1.0)))
    if last_pixel < first_pixel:
        return np.int64(0), np.int64(0)
    return first_pixel // TILE, last_pixel // TILE + 1
