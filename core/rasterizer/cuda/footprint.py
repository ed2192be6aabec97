"""A Gaussian in the picture (core.rasterizer.layout), and which tiles it touches:
core.rasterizer.cpu.footprint for a GPU."""

import triton
import triton.language as tl

from core.rasterizer import layout

TILE, COLUMNS = tl.constexpr(layout.TILE), tl.constexpr(layout.FOOTPRINT_COLUMNS)
X, Y, SLOPE = tl.constexpr(layout.X), tl.constexpr(layout.Y), tl.constexpr(layout.SLOPE)
SHARPNESS, FALL, STRENGTH = tl.constexpr(layout.SHARPNESS), tl.constexpr(layout.FALL), tl.constexpr(layout.STRENGTH)
RED, GREEN, BLUE = tl.constexpr(layout.RED), tl.constexpr(layout.GREEN), tl.constexpr(layout.BLUE)
HALF_HEIGHT, HALF_WIDTH = tl.constexpr(layout.HALF_HEIGHT), tl.constexpr(layout.HALF_WIDTH)
LEAN = tl.constexpr(layout.LEAN)

# Where the ellipse ends depends on roots of differences, which float32 rounds by more than a pixel for ellipses of a
# thousand pixels. So it is made larger, by far more than alpha is rounded: a generous bound costs a test, a narrow one
# a pixel.
ENLARGED = tl.constexpr(1.0001)  # of d' S^-1 d
SLACK_PX = tl.constexpr(0.01)
SLACK = tl.constexpr(1e-6)  # of the distances, eight times float32's rounding


@triton.jit
def tiles_between(low, high, slack, size):
    """The tiles [first, last) along an axis of `size` pixels
    that hold pixel centres in [low - slack, high + slack] (px)."""
    # Clamped before it becomes an integer: the cast of a float beyond the integers' range is undefined.
    first_pixel = tl.ceil(tl.minimum(tl.maximum(low - slack - 0.5, 0.0), size)).to(tl.int32)
    last_pixel = tl.floor(tl.minimum(tl.maximum(high + slack - 0.5, -1.0), size - 1.0)).to(tl.int32)
    some = last_pixel >= first_pixel
    return tl.where(some, first_pixel // TILE, 0), tl.where(some, last_pixel // TILE + 1, 0)


@triton.jit
def touched_rows(y, half_height, height):
    """The tile rows [first, last) that hold pixel centres within the ellipse."""
    slack = (tl.abs(y) + half_height) * SLACK + SLACK_PX
    return tiles_between(y - half_height, y + half_height, slack, height)


@triton.jit
def touched_columns(x, y, slope, half_height, half_width, lean, tile_row, width):
    """The tiles [first, last) of a tile row that the ellipse touches: all of them, as an ellipse has no holes.

    From where it reaches furthest to the right its right border recedes on either side, so that within a band of rows
    it reaches furthest in the row nearest to that. The left is the mirror image.
    """
    top = tile_row * TILE + 0.5 - y
    bottom = top + (TILE - 1.0)
    right_row = tl.minimum(tl.maximum(lean, top), bottom)
    left_row = tl.minimum(tl.maximum(-lean, top), bottom)
    right = slope * right_row + half_width * half_chord(right_row / half_height)
    left = slope * left_row - half_width * half_chord(left_row / half_height)
    slack = (tl.abs(x) + tl.abs(slope) * half_height + half_width) * SLACK + SLACK_PX
    return tiles_between(x + left, x + right, slack, width)


@triton.jit
def half_chord(height):
    """Of the unit circle, at a height above its centre; 0 outside."""
    return tl.sqrt_rn(tl.maximum((1.0 - height) * (1.0 + height), 0.0))
