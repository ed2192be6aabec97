"""What both backends of kernels keep: a Gaussian in the picture, as the blending reads it,
and what the blending says of it in each tile.

The quadratic form is kept factored, as the distribution of x given y times that of y. With the 2D covariance [[a, b],
[b, c]] and det = a c - b^2

    d' S^-1 d = (c / det) (dx - (b / c) dy)^2 + dy^2 / c

Written out, a conic loses all its digits for a needle that crosses the picture: terms of 1e5 cancel to 1. Here nothing
cancels, and the cost is the same: two fused multiply-adds per pixel, as the row's share is known in advance.
"""

from math import e, log2

TILE = 16  # pixels per side
HALF_LOG2_E = 0.5 * log2(e)

# A row of the footprints. With d = pixel - centre,
# log2(alpha) = STRENGTH - (SHARPNESS (dx - SLOPE dy))^2 - FALL dy^2
X, Y = 0, 1  # centre, px
SLOPE = 2  # b / c: how far the ellipse leans, px per px
SHARPNESS = 3  # sqrt(HALF_LOG2_E c / det), 1 / px
FALL = 4  # HALF_LOG2_E / c, 1 / px^2
STRENGTH = 5  # log2(opacity)
RED, GREEN, BLUE = 6, 7, 8
# The ellipse alpha >= ALPHA_MIN: half its height; half its width on the row through its centre; how far below its
# centre it reaches furthest to the right, which is how far above it reaches furthest to the left. All px.
HALF_HEIGHT, HALF_WIDTH, LEAN = 9, 10, 11
FOOTPRINT_COLUMNS = 12

# A row of the slots' gradients. With g = alpha dL/d alpha and e = dx - slope dy, sums over the pixels of a tile of:
SUM_G, SUM_GE, SUM_GEE, SUM_GY, SUM_GEY, SUM_GYY = 0, 1, 2, 3, 4, 5  # g, g e, g e^2, g dy, g e dy, g dy^2
SUM_RED, SUM_GREEN, SUM_BLUE = 6, 7, 8  # w v
SLOT_COLUMNS = 9
SUM_COLOUR = slice(SUM_RED, SUM_BLUE + 1)


def tiles_along(pixels: int) -> int:
    """How many tiles a side of so many pixels has; at its end they may be cut off."""
    return (pixels + TILE - 1) // TILE
