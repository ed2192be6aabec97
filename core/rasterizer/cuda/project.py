"""Gaussians to footprints: culling, projection, colour, and how many tiles each touches."""

import triton
import triton.language as tl

from core.rasterizer.cuda import footprint
from core.rasterizer.cuda.footprint import touched_columns, touched_rows
from core.rasterizer.cuda.geometry import (
    HALF_LOG2_E,
    can_be_projected,
    depth_of,
    ellipse,
    level_of,
    meets_picture,
    offset_from,
    opacity_of,
    parameters_of,
)
from core.rasterizer.cuda.harmonics import colour, is_finite
from core.rasterizer.cuda.vectors import unit
from core.rasterizer.cuda.view import HEIGHT, WIDTH

BLOCK, WARPS = 32, 1  # Gaussians per program, one per thread


@triton.jit
def extent(a, b, c, determinant, level):
    """The SLOPE, HALF_HEIGHT, HALF_WIDTH and LEAN of the ellipses, ENLARGED for the tile lists."""
    inverse_c = 1.0 / c
    enlarged = level * footprint.ENLARGED
    half_height, half_width = tl.sqrt_rn(enlarged * c), tl.sqrt_rn(enlarged * (determinant * inverse_c))
    return b * inverse_c, half_height, half_width, b * enlarged / tl.sqrt_rn(enlarged * a)


@triton.jit
def tiles_touched(view, x, y, slope, half_height, half_width, lean, shows):
    """How many tiles the ellipses touch; 0 where nothing shows."""
    first_row, last_row = touched_rows(y, half_height, tl.load(view + HEIGHT))
    rows = tl.where(shows, last_row - first_row, 0)
    touched = tl.zeros_like(rows)
    most_rows = tl.max(rows, axis=0)
    step = 0
    while step < most_rows:
        first, last = touched_columns(
            x, y, slope, half_height, half_width, lean, first_row + step, tl.load(view + WIDTH)
        )
        touched += tl.where(step < rows, last - first, 0)
        step += 1
    return touched


@triton.jit(do_not_specialize=["count"])
def find_visible(
    means, quaternions, log_scales, logit_opacities, sh, view, visible, count,
    COEFFICIENTS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Write to `visible` (2, N) int32 which Gaussians are not culled, 1 or 0, and how many tiles each touches."""
    row = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    known = row < count
    mean, quaternion, log_scale, logit = parameters_of(means, quaternions, log_scales, logit_opacities, row, known)
    offset = offset_from(view, mean)
    depth = depth_of(view, offset)
    shows = can_be_projected(offset, quaternion, log_scale, logit, depth)
    x, y, a, b, c, determinant = ellipse(view, offset, depth, quaternion, log_scale)
    level = level_of(opacity_of(logit))
    shows &= meets_picture(view, x, y, a, c, determinant, level)
    shows &= is_finite(sh, row, known, COEFFICIENTS)
    tl.store(visible + row, shows.to(tl.int32), mask=known)
    slope, half_height, half_width, lean = extent(a, b, c, determinant, level)
    touched = tiles_touched(view, x, y, slope, half_height, half_width, lean, known & shows)
    tl.store(visible + count + row, touched, mask=known)


@triton.jit(do_not_specialize=["count"])
def project(
    means, quaternions, log_scales, logit_opacities, sh, probe, view, footprints, depths, tile_counts, count,
    COEFFICIENTS: tl.constexpr, PROBED: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Write the footprints (N, footprint.COLUMNS) of the Gaussians,
    their depths (N,) and how many tiles each touches (N,).

    Of the culled no footprint is written, a depth of infinity, and a count of 0. probe: (N, 2), added to the centres
    (px); read if PROBED.
    """
    row = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    known = row < count
    mean, quaternion, log_scale, logit = parameters_of(means, quaternions, log_scales, logit_opacities, row, known)
    offset = offset_from(view, mean)
    depth = depth_of(view, offset)
    shows = known & can_be_projected(offset, quaternion, log_scale, logit, depth)
    x, y, a, b, c, determinant = ellipse(view, offset, depth, quaternion, log_scale)
    if PROBED:
        x += tl.load(probe + 2 * row, mask=known, other=0.0)
        y += tl.load(probe + 2 * row + 1, mask=known, other=0.0)
    opacity = opacity_of(logit)
    level = level_of(opacity)
    shows &= meets_picture(view, x, y, a, c, determinant, level)
    direction, _ = unit(offset)
    red, green, blue = colour(sh, row, direction, known, COEFFICIENTS)
    shows &= 0.0 * (red + green + blue) == 0.0  # NaN or infinite, as a coefficient must be

    slope, half_height, half_width, lean = extent(a, b, c, determinant, level)
    at = footprints + row * footprint.COLUMNS
    tl.store(at + footprint.X, x, mask=shows)
    tl.store(at + footprint.Y, y, mask=shows)
    tl.store(at + footprint.SLOPE, slope, mask=shows)
    tl.store(at + footprint.SHARPNESS, tl.sqrt_rn(c / determinant * HALF_LOG2_E), mask=shows)
    tl.store(at + footprint.FALL, 1.0 / c * HALF_LOG2_E, mask=shows)
    tl.store(at + footprint.STRENGTH, tl.log2(opacity), mask=shows)
    tl.store(at + footprint.RED, tl.maximum(red, 0.0), mask=shows)
    tl.store(at + footprint.GREEN, tl.maximum(green, 0.0), mask=shows)
    tl.store(at + footprint.BLUE, tl.maximum(blue, 0.0), mask=shows)
    tl.store(at + footprint.HALF_HEIGHT, half_height, mask=shows)
    tl.store(at + footprint.HALF_WIDTH, half_width, mask=shows)
    tl.store(at + footprint.LEAN, lean, mask=shows)
    tl.store(depths + row, tl.where(shows, depth, float("inf")), mask=known)
    touched = tiles_touched(view, x, y, slope, half_height, half_width, lean, shows)
    tl.store(tile_counts + row, touched, mask=known)
