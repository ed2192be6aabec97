"""A Gaussian in the picture, as the blending reads it, and which tiles it touches.

The quadratic form is kept factored, as the distribution of x given y times that of y. With the 2D covariance [[a, b], [b, c]]
and det = a c - b^2

    d' S^-1 d = (c / det) (dx - (b / c) dy)^2 + dy^2 / c

Written out, a conic loses all its digits for a needle that crosses the picture: terms of 1e5 cancel to 1. Here nothing
cancels, and the cost is the same: two fused multiply-adds a pixel, as the row's share is known in advance.
"""

import math

import numpy as np
from numba import njit

from core.rasterizer.contract import ALPHA_MIN

TILE = 16  # pixels a side; two chunks of eight across

# A row of the footprints. With d = pixel - centre,
# log2(alpha) = STRENGTH - (SHARPNESS (dx - SLOPE dy))^2 - FALL dy^2
X, Y = 0, 1  # centre, px
SLOPE = 2  # b / c: how far the ellipse leans, px a px
SHARPNESS = 3  # sqrt(log2(e) / 2 * c / det), 1 / px
FALL = 4  # log2(e) / 2 / c, 1 / px^2
STRENGTH = 5  # log2(opacity)
RED, GREEN, BLUE = 6, 7, 8
WIDTH = 12  # floats a row: three 16-byte words

LOG2_ALPHA_MIN = math.log2(ALPHA_MIN)
# Rounding of centres far outside the picture. Generous bounds cost a test, narrow ones a pixel.
SLACK_PX = 0.01


@njit(error_model="numpy")
def extent_of(footprints, i):
    """What the two functions below need of footprint `i`'s ellipse alpha >= ALPHA_MIN, in float64.

    Its centre x, y; slope; half its width on the row through the centre; half its height; and how far below its centre
    it reaches furthest to the right, which is how far above it reaches furthest to the left.
    """
    slope, fall = footprints[i, SLOPE] * 1.0, footprints[i, FALL] * 1.0
    # How far log2(alpha) may fall below its peak; above zero, as it is divided by.
    level = max(footprints[i, STRENGTH] - LOG2_ALPHA_MIN, 1e-6)
    half_width = math.sqrt(level) / footprints[i, SHARPNESS]
    variance = level / fall
    lean = slope * variance / math.sqrt(slope * slope * variance + half_width * half_width)
    return footprints[i, X] * 1.0, footprints[i, Y] * 1.0, slope, half_width, math.sqrt(variance), lean


@njit(error_model="numpy")
def touched_rows(extent, height):
    """The tile rows [first, last) that hold pixel centres within the ellipse."""
    _, y, _, _, half_height, _ = extent
    return tiles_between(y - half_height, y + half_height, height)


@njit(error_model="numpy")
def touched_columns(extent, tile_row, width):
    """The tiles [first, last) of a tile row that the ellipse touches: all of them, as an ellipse has no holes.

    Where the ellipse reaches furthest to the right it is `lean` below its centre. From there its right border recedes on
    either side, so that within a band of rows it reaches furthest in the row nearest to that. The left is the mirror image.
    """
    x, y, slope, half_width, half_height, lean = extent
    top = tile_row * TILE + 0.5 - y
    bottom = top + (TILE - 1.0)
    right_row, left_row = min(max(lean, top), bottom), min(max(-lean, top), bottom)
    right = slope * right_row + half_width * half_chord(right_row / half_height)
    left = slope * left_row - half_width * half_chord(left_row / half_height)
    return tiles_between(x + left, x + right, width)


@njit(error_model="numpy")
def half_chord(height):
    """Of the unit circle, at a height above its centre; 0 outside."""
    return math.sqrt(max(1.0 - height * height, 0.0))


@njit(error_model="numpy")
def tiles_between(low, high, size):
    """The tiles [first, last) along an axis of `size` pixels that hold pixel centres in [low, high] (px)."""
    # Clamped before it becomes an integer: the cast of a float beyond the integers' range is undefined.
    first_pixel = np.int64(math.ceil(min(max(low - SLACK_PX - 0.5, 0.0), size + 0.0)))
    last_pixel = np.int64(math.floor(min(max(high + SLACK_PX - 0.5, -1.0), size - 1.0)))
    if last_pixel < first_pixel:
        return np.int64(0), np.int64(0)
    return first_pixel // TILE, last_pixel // TILE + 1
