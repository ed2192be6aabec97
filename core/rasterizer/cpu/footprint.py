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
def level_of(strength):
    """How far log2(alpha) may fall below its peak within the ellipse; above zero, as it is divided by."""
    return max(strength - LOG2_ALPHA_MIN, 1e-6)


@njit(error_model="numpy")
def touched_rows(y, fall, strength, height):
    """The tile rows [first, last) that hold pixel centres within the ellipse alpha >= ALPHA_MIN."""
    reach = math.sqrt(level_of(strength) / fall)
    return tiles_between(y - reach, y + reach, height)


@njit(error_model="numpy")
def touched_columns(x, y, slope, sharpness, fall, strength, tile_row, width):
    """The tiles [first, last) of a tile row that the ellipse touches: all of them, as an ellipse has no holes.

    Where the ellipse reaches furthest to the right its height above the centre is `lean`; on either side its border recedes, so
    within a band of rows it reaches furthest at the row nearest to that. To the left the same, mirrored.
    """
    level = level_of(strength)
    variance = level / fall
    reach = math.sqrt(slope * slope * variance + level / (sharpness * sharpness))
    lean = slope * variance / reach
    top = tile_row * TILE + 0.5 - y
    bottom = top + TILE - 1.0
    right_row = min(max(lean, top), bottom)
    left_row = min(max(-lean, top), bottom)
    right = slope * right_row + math.sqrt(max(level - fall * right_row * right_row, 0.0)) / sharpness
    left = slope * left_row - math.sqrt(max(level - fall * left_row * left_row, 0.0)) / sharpness
    return tiles_between(x + left, x + right, width)


@njit(error_model="numpy")
def tiles_between(low, high, size):
    """The tiles [first, last) along an axis of `size` pixels that hold pixel centres in [low, high] (px)."""
    # Clamped before it becomes an integer: the cast of a float beyond the integers' range is undefined.
    first_pixel = np.int64(math.ceil(min(max(low - SLACK_PX - 0.5, 0.0), size + 0.0)))
    last_pixel = np.int64(math.floor(min(max(high + SLACK_PX - 0.5, -1.0), size - 1.0)))
    if last_pixel < first_pixel:
        return np.int64(0), np.int64(0)
    return first_pixel // TILE, last_pixel // TILE + 1
