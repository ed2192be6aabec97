"""A Gaussian in the picture, as the blending reads it, and which tiles it touches: core.rasterizer.cpu.footprint for a GPU."""

import triton
import triton.language as tl

TILE = tl.constexpr(16)  # pixels a side

# A row of the footprints. With d = pixel - centre,
# log2(alpha) = STRENGTH - (SHARPNESS (dx - SLOPE dy))^2 - FALL dy^2
X, Y = tl.constexpr(0), tl.constexpr(1)  # centre, px
SLOPE = tl.constexpr(2)  # how far the ellipse leans, px a px
SHARPNESS = tl.constexpr(3)  # 1 / px
FALL = tl.constexpr(4)  # 1 / px^2
STRENGTH = tl.constexpr(5)  # log2(opacity)
RED, GREEN, BLUE = tl.constexpr(6), tl.constexpr(7), tl.constexpr(8)
# The ellipse alpha >= ALPHA_MIN, a trifle enlarged: half its height; half its width on the row through its centre; how far
# below its centre it reaches furthest to the right. All px.
HALF_HEIGHT, HALF_WIDTH, LEAN = tl.constexpr(9), tl.constexpr(10), tl.constexpr(11)
COLUMNS = tl.constexpr(12)

# Where the ellipse ends depends on roots of differences, which float32 rounds by more than a pixel for ellipses of a thousand
# pixels. So it is made larger, by far more than alpha is rounded: a generous bound costs a test, a narrow one a pixel.
ENLARGED = tl.constexpr(1.0001)  # of d' S^-1 d
SLACK_PX = tl.constexpr(0.01)
SLACK = tl.constexpr(1e-6)  # of the distances, eight times float32's rounding


@triton.jit
def tiles_between(low, high, slack, size):
    """The tiles [first, last) along an axis of `size` pixels that hold pixel centres in [low - slack, high + slack] (px)."""
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
