"""Gaussians to footprints: culling, projection and, apart from them, colour.
The definition is core.rasterizer.reference.

Scalar code, in float64 throughout: without vectors it costs what float32 costs, and leaves only the final rounding.
"""

import math

import numpy as np

from core.kernels.compiled import kernel, part
from core.rasterizer import layout
from core.rasterizer.contract import ALPHA_MIN, BLUR_PX2, LEAST_LOGIT, LOG2_ALPHA_MIN, LOG_SCALE_RANGE, NEAR
from core.rasterizer.cpu.bin import add_to_loads
from core.rasterizer.cpu.footprint import tiles_along
from core.rasterizer.cpu.harmonics import colour, fill_basis, is_finite
from core.rasterizer.cpu.vectors import cross, dot, row, scaled, subtract
from core.rasterizer.layout import HALF_LOG2_E
from core.scene.splats import QUATERNION_MIN_NORM2

LEAST_LOG_SCALE, MOST_LOG_SCALE = LOG_SCALE_RANGE
MOST_LEVEL = 2.0 * math.log(1.0 / ALPHA_MIN) * (1 + 1e-9)  # `level_of` an opacity of 1, and rounding
SPHERE_MARGIN = 1 + 1e-9  # rounding of the axes' lengths


@part
def can_be_projected(means, quaternions, log_scales, logit_opacities, i, depth):
    """Whether Gaussian `i` is finite (its SH apart), in front of the camera,
    rotated by a valid quaternion, not too faint.

    Every test is written so that NaN fails it.
    """
    w, x, y, z = quaternion_of(quaternions, i)
    total = w + x + y + z + logit_opacities[i]
    for k in range(3):
        total += np.float64(means[i, k]) + log_scales[i, k]
    return (
        depth > NEAR
        and total - total == 0
        and w * w + x * x + y * y + z * z >= QUATERNION_MIN_NORM2
        and logit_opacities[i] >= LEAST_LOGIT
    )


@part
def quaternion_of(quaternions, i):
    """Quaternion `i` as it stands, w x y z."""
    w, x, y, z = quaternions[i, 0], quaternions[i, 1], quaternions[i, 2], quaternions[i, 3]
    return np.float64(w), np.float64(x), np.float64(y), np.float64(z)


@part
def axes_of(quaternions, i):
    """Gaussian `i`'s unit quaternion, the inverse of its norm, and its rotation's columns: the ellipsoid's axes."""
    w, x, y, z = quaternion_of(quaternions, i)
    inverse_norm = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * inverse_norm, x * inverse_norm, y * inverse_norm, z * inverse_norm
    first = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
    second = (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x))
    third = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
    return (w, x, y, z), inverse_norm, (first, second, third)


@part
def scales_of(log_scales, i):
    """The standard deviations along the axes."""
    first, second, third = row(log_scales, i)
    return (
        math.exp(min(max(first, LEAST_LOG_SCALE), MOST_LOG_SCALE)),
        math.exp(min(max(second, LEAST_LOG_SCALE), MOST_LOG_SCALE)),
        math.exp(min(max(third, LEAST_LOG_SCALE), MOST_LOG_SCALE)),
    )


@part
def opacity_of(logit):
    """The sigmoid of a logit."""
    return 1.0 / (1.0 + math.exp(-np.float64(logit)))


@part
def slopes_of(offset, rotation, limits):
    """The inverse depth, x / z and y / z, and the latter two clamped to `limits`, which is for the Jacobian only."""
    inverse_depth = 1.0 / dot(row(rotation, 2), offset)
    x, y = inverse_depth * dot(row(rotation, 0), offset), inverse_depth * dot(row(rotation, 1), offset)
    left, right, top, bottom = limits
    return inverse_depth, x, y, min(max(x, left), right), min(max(y, top), bottom)


@part
def pixel_gradient(rotation, line, zoom, slope):
    """How a pixel coordinate (line 0: x, 1: y) moves with a point of the world: a row of J W. zoom: focal / depth."""
    return scaled(zoom, subtract(row(rotation, line), scaled(slope, row(rotation, 2))))


@part
def projected_axes(gradient, axes, scales):
    """The Gaussian's axes along a picture axis, px: a row of the factor V = J W R S of the 2D covariance V V'."""
    return scales[0] * dot(gradient, axes[0]), scales[1] * dot(gradient, axes[1]), scales[2] * dot(gradient, axes[2])


@part
def covariance(across, down):
    """The entries a, b, c of V V' + blur and its determinant, px^2 and px^4."""
    a, b, c = dot(across, across), dot(across, down), dot(down, down)
    # det(V V' + e I) from the factor: the difference a c - b^2 is nothing but rounding for a needle.
    normal = cross(across, down)
    determinant = dot(normal, normal) + BLUR_PX2 * (a + c) + BLUR_PX2 * BLUR_PX2
    return a + BLUR_PX2, b, c + BLUR_PX2, determinant


@part
def ellipse(i, offset, quaternions, log_scales, rotation, lens, limits):
    """Centre (px) and covariance entries a, b, c, determinant of Gaussian `i`, which passed `can_be_projected`."""
    fx, fy, cx, cy = lens
    inverse_depth, x, y, clamped_x, clamped_y = slopes_of(offset, rotation, limits)
    _, _, axes = axes_of(quaternions, i)
    scales = scales_of(log_scales, i)
    across = projected_axes(pixel_gradient(rotation, 0, fx * inverse_depth, clamped_x), axes, scales)
    down = projected_axes(pixel_gradient(rotation, 1, fy * inverse_depth, clamped_y), axes, scales)
    a, b, c, determinant = covariance(across, down)
    return fx * x + cx, fy * y + cy, a, b, c, determinant


@part
def level_of(opacity):
    """d' S^-1 d where opacity * exp(-d' S^-1 d / 2) has fallen to ALPHA_MIN; never 0, as its root is divided by."""
    return max(2.0 * math.log(opacity / ALPHA_MIN), 1e-6)


@part
def meets_picture(x, y, reach_x, reach_y, size):
    """Whether the box around an ellipse with centre x, y meets the picture."""
    return x + reach_x >= 0 and x - reach_x <= size[0] and y + reach_y >= 0 and y - reach_y <= size[1]


@part
def fits(channel):
    """Whether a colour's channel is a finite float32 number: SH may be NaN, infinite or too large for that."""
    held = np.float32(channel)
    return held - held == 0


@part
def centre_in_picture(offset, rotation, lens, limits, size):
    fx, fy, cx, cy = lens
    _, x, y, _, _ = slopes_of(offset, rotation, limits)
    return meets_picture(fx * x + cx, fy * y + cy, 0.0, 0.0, size)


@part
def sphere_meets_picture(i, offset, log_scales, rotation, lens, limits, size):
    """Whether the picture is met by the box around an opaque sphere of Gaussian `i`'s largest scale:
    its own lies within."""
    fx, fy, cx, cy = lens
    inverse_depth, x, y, clamped_x, clamped_y = slopes_of(offset, rotation, limits)
    across = pixel_gradient(rotation, 0, fx * inverse_depth, clamped_x)
    down = pixel_gradient(rotation, 1, fy * inverse_depth, clamped_y)
    largest = max(log_scales[i, 0], log_scales[i, 1], log_scales[i, 2])
    scale = math.exp(min(max(np.float64(largest), LEAST_LOG_SCALE), MOST_LOG_SCALE))
    variance = scale * scale * SPHERE_MARGIN
    reach_x = math.sqrt(MOST_LEVEL * (variance * dot(across, across) + BLUR_PX2))
    reach_y = math.sqrt(MOST_LEVEL * (variance * dot(down, down) + BLUR_PX2))
    return meets_picture(fx * x + cx, fy * y + cy, reach_x, reach_y, size)


@kernel
def find_visible(
    begin, end, means, quaternions, log_scales, logit_opacities, sh, rotation, centre, lens, limits, size, visible
):
    """Write to `visible` (N,) bool which of the Gaussians `begin` to `end` are not culled."""
    for i in range(begin, end):
        visible[i] = False
        offset = subtract(row(means, i), centre)
        depth = dot(row(rotation, 2), offset)
        if not can_be_projected(means, quaternions, log_scales, logit_opacities, i, depth):
            continue
        # What the ellipse would say is mostly plain from the centre, and from the largest scale.
        inside = centre_in_picture(offset, rotation, lens, limits, size)
        if not inside and sphere_meets_picture(i, offset, log_scales, rotation, lens, limits, size):
            x, y, a, _, c, _ = ellipse(i, offset, quaternions, log_scales, rotation, lens, limits)
            level = level_of(opacity_of(logit_opacities[i]))
            inside = meets_picture(x, y, math.sqrt(level * a), math.sqrt(level * c), size)
        visible[i] = inside and is_finite(sh, i)


@kernel
def project(
    begin, end, rows, means, quaternions, log_scales, logit_opacities, probe, rotation, centre, lens, limits, size,
    footprints, depths, tile_counts, tile_loads,
):  # fmt: skip
    """Write the footprints, colours apart, and the depths of the Gaussians rows[begin:end].

    rows: (V,) int64. footprints: (V, layout.FOOTPRINT_COLUMNS). depths: (V,) float32. tile_counts: (V,) int32, the
    number of tiles that each touches. Of the culled only this is written, a zero. tile_loads: (tiles,) int32, of this
    block, to which it adds how many of the Gaussians touch each tile. probe: (V, 2) float32, added to the centres (px),
    or empty.
    """
    columns = tiles_along(size[0])
    for index in range(begin, end):
        i = rows[index]
        tile_counts[index] = 0
        offset = subtract(row(means, i), centre)
        depth = dot(row(rotation, 2), offset)
        if not can_be_projected(means, quaternions, log_scales, logit_opacities, i, depth):
            continue
        x, y, a, b, c, determinant = ellipse(i, offset, quaternions, log_scales, rotation, lens, limits)
        if len(probe) > 0:
            x += probe[index, 0]
            y += probe[index, 1]
        level = level_of(opacity_of(logit_opacities[i]))
        reach_x, reach_y = math.sqrt(level * a), math.sqrt(level * c)
        if not meets_picture(x, y, reach_x, reach_y, size):
            continue

        inverse_c = 1.0 / c
        variance_in_row = determinant * inverse_c
        footprints[index, layout.X] = x
        footprints[index, layout.Y] = y
        footprints[index, layout.SLOPE] = b * inverse_c
        footprints[index, layout.SHARPNESS] = math.sqrt(HALF_LOG2_E / variance_in_row)
        footprints[index, layout.FALL] = HALF_LOG2_E * inverse_c
        footprints[index, layout.STRENGTH] = HALF_LOG2_E * level + LOG2_ALPHA_MIN
        footprints[index, layout.HALF_HEIGHT] = reach_y
        footprints[index, layout.HALF_WIDTH] = math.sqrt(level * variance_in_row)
        footprints[index, layout.LEAN] = b * level / reach_x
        depths[index] = depth
        tile_counts[index] = add_to_loads(footprints, index, size, columns, tile_loads)


@kernel
def colour_footprints(begin, end, means, sh, centre, slot_starts, uncoloured, footprints):
    """Write the footprints `begin` to `end` of those that touch a tile,
    in the colours that these harmonics show to the camera's centre.

    uncoloured: as `project` wrote them. A Gaussian with a channel that does not fit is not drawn.
    """
    basis = np.empty(16)
    for i in range(begin, end):
        if slot_starts[i] == slot_starts[i + 1]:
            continue
        offset = subtract(row(means, i), centre)
        fill_basis(basis, scaled(1.0 / math.sqrt(dot(offset, offset)), offset), sh.shape[1])
        red, green, blue = colour(sh, i, basis)
        for column in range(layout.FOOTPRINT_COLUMNS):  # a whole row takes Numba three seconds to compile
            footprints[i, column] = uncoloured[i, column]
        footprints[i, layout.RED] = max(red, 0.0)
        footprints[i, layout.GREEN] = max(green, 0.0)
        footprints[i, layout.BLUE] = max(blue, 0.0)
        if not (fits(red) and fits(green) and fits(blue)):
            footprints[i, layout.STRENGTH] = -np.inf
