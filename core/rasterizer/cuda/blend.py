"""What forward and backward blending share: a tile's pixels, one a lane, and a splat's coverage of them.

One program blends one tile. Its pixels are a flat tensor of 256, of which every thread holds a few in registers; splats
are read as scalars, the same for all lanes. Whether all pixels are finished is asked every BATCH splats only.
"""

import math

import triton
import triton.language as tl

from core.rasterizer import contract, layout
from core.rasterizer.cuda import footprint

PIXELS = tl.constexpr(layout.TILE**2)
BATCH = tl.constexpr(16)
LOG2_ALPHA_MIN = tl.constexpr(math.log2(contract.ALPHA_MIN))
ALPHA_MAX = tl.constexpr(contract.ALPHA_MAX)
STOP = tl.constexpr(contract.STOP_TRANSMITTANCE)


@triton.jit
def pixels_of(tile, columns, width, height):
    """Of the tile's pixels: the centres x, y (px), the place in the picture, and whether they lie inside it."""
    lane = tl.arange(0, PIXELS)
    column = tile % columns * footprint.TILE + lane % footprint.TILE
    row = tile // columns * footprint.TILE + lane // footprint.TILE
    inside = (column < width) & (row < height)
    return column.to(tl.float32) + 0.5, row.to(tl.float32) + 0.5, row * width + column, inside


@triton.jit
def coverage(footprints, splat, x, y):
    """Alpha of a splat in the pixels before the clamp at ALPHA_MAX, 0 where it is below ALPHA_MIN; and e = dx - slope dy, dy."""
    at = footprints + splat * footprint.COLUMNS
    dy = y - tl.load(at + footprint.Y)
    e = tl.fma(-tl.load(at + footprint.SLOPE), dy, x - tl.load(at + footprint.X))
    across = tl.load(at + footprint.SHARPNESS) * e
    along = tl.fma(-tl.load(at + footprint.FALL) * dy, dy, tl.load(at + footprint.STRENGTH))
    exponent = tl.fma(negative(across), across, along)
    return tl.where(exponent >= LOG2_ALPHA_MIN, tl.exp2(exponent), 0.0), e, dy


@triton.jit
def blended(light, alpha):
    """A splat over what is left of the light: (alpha or 0 where the pixel is finished, weight, the light behind it, 1 - alpha).

    light is negative once its pixel is finished (or lies outside the picture), so that it then fails the test against STOP
    for good.
    """
    left = 1.0 - alpha
    rest = light * left  # not light - alpha * light, which behind an opaque splat is a difference of nearly equal numbers
    goes_on = rest >= STOP
    shown = tl.where(goes_on, alpha, 0.0)
    return shown, shown * light, tl.where(goes_on, rest, negative(tl.abs(light))), left


@triton.jit
def negative(x):
    """-x, which Triton writes as 0 - x: an instruction of its own, where a sign costs none."""
    return x * -1.0
