"""Gaussians to footprints: culling, projection, colour. The definition is core.rasterizer.reference.

Scalar code, in float64 throughout: without vectors it costs what float32 costs, and leaves only the final rounding.
"""

import math

import numpy as np
from numba import njit

from core.rasterizer.contract import (
    ALPHA_MIN,
    BLUR_PX2,
    JACOBIAN_MARGIN,
    LOG_SCALE_RANGE,
    NEAR,
    QUATERNION_MIN_NORM2,
)
from core.rasterizer.cpu import footprint
from core.rasterizer.cpu.footprint import touched_columns, touched_rows
from core.rasterizer.cpu.harmonics import colour, fill_basis, is_finite
from core.rasterizer.cpu.simd import fetch_add
from core.rasterizer.cpu.tuples import cross, dot, row, scaled, subtract

BLOCK = 512  # Gaussians a thread takes at a time
HALF_LOG2_E = 0.5 * math.log2(math.e)
MOST_LOG_SCALE, LEAST_LOG_SCALE = LOG_SCALE_RANGE[1], LOG_SCALE_RANGE[0]


@njit(error_model="numpy")
def can_be_projected(means, quaternions, log_scales, logit_opacities, i, depth):
    """Whether Gaussian `i` is finite (its SH apart), in front of the camera, rotated by a real rotation, not too faint.

    Every test is written so that NaN fails it.
    """
    w, x, y, z = quaternions[i, 0] * 1.0, quaternions[i, 1] * 1.0, quaternions[i, 2] * 1.0, quaternions[i, 3] * 1.0
    total = w + x + y + z + logit_opacities[i]
    for k in range(3):
        total += means[i, k] * 1.0 + log_scales[i, k]
    return (
        depth > NEAR
        and total - total == 0
        and w * w + x * x + y * y + z * z >= QUATERNION_MIN_NORM2
        and opacity_of(logit_opacities[i]) >= ALPHA_MIN
    )


@njit(error_model="numpy")
def opacity_of(logit):
    return 1.0 / (1.0 + math.exp(-np.float64(logit)))


@njit(error_model="numpy")
def axes_of(quaternions, i):
    """The unit quaternion of Gaussian `i`, its norm, and the columns of its rotation matrix: the ellipsoid's axes."""
    w, x, y, z = quaternions[i, 0] * 1.0, quaternions[i, 1] * 1.0, quaternions[i, 2] * 1.0, quaternions[i, 3] * 1.0
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    first = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
    second = (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x))
    third = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
    return (w, x, y, z), norm, (first, second, third)


@njit(error_model="numpy")
def scales_of(log_scales, i):
    """The standard deviations along the axes."""
    return (
        math.exp(min(max(log_scales[i, 0] * 1.0, LEAST_LOG_SCALE), MOST_LOG_SCALE)),
        math.exp(min(max(log_scales[i, 1] * 1.0, LEAST_LOG_SCALE), MOST_LOG_SCALE)),
        math.exp(min(max(log_scales[i, 2] * 1.0, LEAST_LOG_SCALE), MOST_LOG_SCALE)),
    )


@njit(error_model="numpy")
def clamped_slope(slope, focal, principal, size):
    """x / z (or y / z), clamped to the picture's box widened by JACOBIAN_MARGIN: for the Jacobian only."""
    margin = JACOBIAN_MARGIN * size
    return min(max(slope, (-margin - principal) / focal), (size + margin - principal) / focal)


@njit(error_model="numpy")
def pixel_gradient(rotation, line, focal, slope, depth):
    """How a pixel coordinate (line 0: x, 1: y) moves with a point of the world: a row of J W."""
    return scaled(focal / depth, subtract(row(rotation, line), scaled(slope, row(rotation, 2))))


@njit(error_model="numpy")
def projected_axes(gradient, axes, scales):
    """The Gaussian's axes as seen along a picture axis, px: a row of the factor V = J W R S of the 2D covariance V V'."""
    return scales[0] * dot(gradient, axes[0]), scales[1] * dot(gradient, axes[1]), scales[2] * dot(gradient, axes[2])


@njit(error_model="numpy")
def covariance(across, down):
    """The entries a, b, c of V V' + blur and its determinant, px^2 and px^4."""
    a, b, c = dot(across, across), dot(across, down), dot(down, down)
    # det(V V' + e I) from the factor: the difference a c - b^2 is nothing but rounding for a needle.
    normal = cross(across, down)
    determinant = dot(normal, normal) + BLUR_PX2 * (a + c) + BLUR_PX2 * BLUR_PX2
    return a + BLUR_PX2, b, c + BLUR_PX2, determinant


@njit(error_model="numpy")
def ellipse(i, offset, depth, quaternions, log_scales, rotation, lens, size):
    """Centre (px) and covariance entries a, b, c, determinant of Gaussian `i`, which passed `can_be_projected`."""
    fx, fy, cx, cy = lens
    slope_x, slope_y = dot(row(rotation, 0), offset) / depth, dot(row(rotation, 1), offset) / depth
    _, _, axes = axes_of(quaternions, i)
    scales = scales_of(log_scales, i)
    to_x = pixel_gradient(rotation, 0, fx, clamped_slope(slope_x, fx, cx, size[0]), depth)
    to_y = pixel_gradient(rotation, 1, fy, clamped_slope(slope_y, fy, cy, size[1]), depth)
    a, b, c, determinant = covariance(projected_axes(to_x, axes, scales), projected_axes(to_y, axes, scales))
    return fx * slope_x + cx, fy * slope_y + cy, a, b, c, determinant


@njit(error_model="numpy")
def meets_picture(x, y, a, c, opacity, size):
    """Whether the box around the ellipse opacity * exp(-d' S^-1 d / 2) >= ALPHA_MIN meets the picture."""
    level = 2.0 * math.log(opacity / ALPHA_MIN)
    reach_x, reach_y = math.sqrt(level * a), math.sqrt(level * c)
    return x + reach_x >= 0 and x - reach_x <= size[0] and y + reach_y >= 0 and y - reach_y <= size[1]


@njit(cache=True, nogil=True, error_model="numpy")
def find_visible(
    counter, means, quaternions, log_scales, logit_opacities, sh, rotation, centre, lens, size, visible
):
    """Write to `visible` (N,) bool which Gaussians are not culled. Takes blocks off `counter` until none are left."""
    count = len(means)
    while True:
        begin = fetch_add(counter, 0, BLOCK)
        if begin >= count:
            return
        for i in range(begin, min(begin + BLOCK, count)):
            visible[i] = False
            offset = subtract(row(means, i), centre)
            depth = dot(row(rotation, 2), offset)
            if not can_be_projected(means, quaternions, log_scales, logit_opacities, i, depth):
                continue
            x, y, a, b, c, determinant = ellipse(i, offset, depth, quaternions, log_scales, rotation, lens, size)
            opacity = opacity_of(logit_opacities[i])
            visible[i] = meets_picture(x, y, a, c, opacity, size) and is_finite(sh, i)


@njit(cache=True, nogil=True, error_model="numpy")
def project(
    counter, means, quaternions, log_scales, logit_opacities, sh, probe, rotation, centre, lens, size,
    footprints, depths, tile_counts, tile_loads,
):  # fmt: skip
    """Write the footprints (N, WIDTH) of the Gaussians and their depths (N,) float32.

    tile_counts: (N,) int32, the number of tiles that each touches; 0 where culled, and nothing else of it is written then.
    tile_loads: (tiles,) int32, this thread's own: for each tile the Gaussians of this thread that touch it are added.
    """
    count = len(means)
    columns = (size[0] + footprint.TILE - 1) // footprint.TILE
    basis = np.empty(16)
    while True:
        begin = fetch_add(counter, 0, BLOCK)
        if begin >= count:
            return
        for i in range(begin, min(begin + BLOCK, count)):
            tile_counts[i] = 0
            offset = subtract(row(means, i), centre)
            depth = dot(row(rotation, 2), offset)
            if not can_be_projected(means, quaternions, log_scales, logit_opacities, i, depth):
                continue
            x, y, a, b, c, determinant = ellipse(i, offset, depth, quaternions, log_scales, rotation, lens, size)
            if len(probe) > 0:
                x += probe[i, 0]
                y += probe[i, 1]
            opacity = opacity_of(logit_opacities[i])
            if not meets_picture(x, y, a, c, opacity, size):
                continue
            fill_basis(basis, scaled(1.0 / math.sqrt(dot(offset, offset)), offset), sh.shape[1])
            red, green, blue = colour(sh, i, basis)
            total = red + green + blue
            if not total - total == 0:
                continue

            footprints[i, footprint.X] = x
            footprints[i, footprint.Y] = y
            footprints[i, footprint.SLOPE] = b / c
            footprints[i, footprint.SHARPNESS] = math.sqrt(HALF_LOG2_E * c / determinant)
            footprints[i, footprint.FALL] = HALF_LOG2_E / c
            footprints[i, footprint.STRENGTH] = math.log2(opacity)
            footprints[i, footprint.RED] = max(red, 0.0)
            footprints[i, footprint.GREEN] = max(green, 0.0)
            footprints[i, footprint.BLUE] = max(blue, 0.0)
            depths[i] = depth
            tile_counts[i] = add_to_loads(footprints, i, size, columns, tile_loads)


@njit(error_model="numpy")
def add_to_loads(footprints, i, size, columns, tile_loads):
    """Count Gaussian `i` in each tile that it touches; how many those are."""
    x, y = footprints[i, footprint.X] * 1.0, footprints[i, footprint.Y] * 1.0
    slope, sharpness = footprints[i, footprint.SLOPE] * 1.0, footprints[i, footprint.SHARPNESS] * 1.0
    fall, strength = footprints[i, footprint.FALL] * 1.0, footprints[i, footprint.STRENGTH] * 1.0
    touched = 0
    first_row, last_row = touched_rows(y, fall, strength, size[1])
    for tile_row in range(first_row, last_row):
        first, last = touched_columns(x, y, slope, sharpness, fall, strength, tile_row, size[0])
        for tile in range(tile_row * columns + first, tile_row * columns + last):
            tile_loads[tile] += 1
        touched += last - first
    return touched
