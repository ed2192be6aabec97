"""What forward and backward blending share: a tile's pixels, one per lane, and a splat's coverage of them.

One program blends one tile. Its pixels are a flat tensor of 256, of which every thread holds a few in registers; splats
are read as scalars, the same for all lanes. Whether all pixels are finished is asked every BATCH splats only.

A small picture has fewer tiles than a GPU has room for programs. There the forward pass divides the pixels of a tile
among programs, and the backward pass the list of its splats: a section of the list can begin without those in front of
it where the forward pass has noted down what the pixels were like there.

Splats are blended in pairs, each read while the one before it is blended: a small picture has too few tiles for the
waiting of one to be hidden by the work of others.
"""

import triton
import triton.language as tl

from core.rasterizer import contract, layout
from core.rasterizer.cuda import footprint

PIXELS = tl.constexpr(layout.TILE**2)
BATCH = tl.constexpr(16)
LOG2_ALPHA_MIN = tl.constexpr(contract.LOG2_ALPHA_MIN)
ALPHA_MAX = tl.constexpr(contract.ALPHA_MAX)
STOP = tl.constexpr(contract.STOP_TRANSMITTANCE)


@triton.jit
def pixels_of(tile, lane, columns, width, height):
    """Of the tile's pixels `lane`, of 0 to PIXELS - 1:
    the centres x, y (px), their offsets in the picture, and whether they lie inside it."""
    column = tile % columns * footprint.TILE + lane % footprint.TILE
    row = tile // columns * footprint.TILE + lane // footprint.TILE
    inside = (column < width) & (row < height)
    return column.to(tl.float32) + 0.5, row.to(tl.float32) + 0.5, row * width + column, inside


@triton.jit
def section_length(entries, sections):
    """How many entries of a tile's list each section of it has but the last, which may have fewer; whole batches."""
    return tl.cdiv(tl.cdiv(entries, sections), BATCH) * BATCH


@triton.jit
def note_of(tile, section, sections, lane):
    """Where the four numbers are noted down that the pixels have at the beginning of a section, light first;
    each PIXELS behind the last."""
    return (tile.to(tl.int64) * sections + section) * 4 * PIXELS + lane


@triton.jit
def splat_of(entry_splats, entry, end):
    """Which splat an entry is; behind the last, the first of all splats."""
    return tl.load(entry_splats + entry, mask=entry < end, other=0)


@triton.jit
def read_splat(footprints, splat, exists):
    """The six numbers of a splat's shape, as `coverage` takes them, and its colour;
    if there is none, nothing to be seen."""
    at = footprints + splat * footprint.COLUMNS
    x = tl.load(at + footprint.X, mask=exists, other=0.0)
    y = tl.load(at + footprint.Y, mask=exists, other=0.0)
    slope = tl.load(at + footprint.SLOPE, mask=exists, other=0.0)
    sharpness = tl.load(at + footprint.SHARPNESS, mask=exists, other=0.0)
    fall = tl.load(at + footprint.FALL, mask=exists, other=0.0)
    strength = tl.load(at + footprint.STRENGTH, mask=exists, other=float("-inf"))
    red = tl.load(at + footprint.RED, mask=exists, other=0.0)
    green = tl.load(at + footprint.GREEN, mask=exists, other=0.0)
    blue = tl.load(at + footprint.BLUE, mask=exists, other=0.0)
    return (x, y, slope, sharpness, fall, strength), (red, green, blue)


@triton.jit
def coverage(shape, x, y):
    """Alpha of a splat in the pixels before the clamp at ALPHA_MAX, 0 where it is below ALPHA_MIN;
    and e = dx - slope dy, dy."""
    middle_x, middle_y, slope, sharpness, fall, strength = shape
    dy = y - middle_y
    e = tl.fma(-slope, dy, x - middle_x)
    across = sharpness * e
    along = tl.fma(-fall * dy, dy, strength)
    exponent = tl.fma(negative(across), across, along)
    return tl.where(exponent >= LOG2_ALPHA_MIN, tl.exp2(exponent), 0.0), e, dy


@triton.jit
def blended(light, alpha):
    """A splat over what is left of the light: (alpha or 0 where the pixel is finished, weight,
    the light behind it, 1 - alpha).

    light is negative once its pixel is finished (or lies outside the picture), so that it then fails the test against
    STOP for good.
    """
    let_through = 1.0 - alpha
    # Not light - alpha * light, which behind an opaque splat is a difference of nearly equal numbers.
    left_over = light * let_through
    goes_on = left_over >= STOP
    shown = tl.where(goes_on, alpha, 0.0)
    return shown, shown * light, tl.where(goes_on, left_over, negative(tl.abs(light))), let_through


@triton.jit
def negative(x):
    """-x, which Triton writes as 0 - x: an instruction of its own, where a sign costs none."""
    return x * -1.0
