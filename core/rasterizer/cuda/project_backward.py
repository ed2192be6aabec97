"""Gradients of the footprints back to the Gaussians' parameters: project.py read in reverse."""

import triton
import triton.language as tl

from core.rasterizer.cuda import footprint
from core.rasterizer.cuda.blend_backward import (
    SLOT_COLUMNS,
    SUM_BLUE,
    SUM_G,
    SUM_GE,
    SUM_GEE,
    SUM_GEY,
    SUM_GREEN,
    SUM_GY,
    SUM_GYY,
    SUM_RED,
)
from core.rasterizer.cuda.geometry import (
    BLUR_PX2,
    LEAST_LOG_SCALE,
    MOST_LOG_SCALE,
    axes_of,
    covariance,
    depth_of,
    offset_from,
    opacity_of,
    parameters_of,
    pixel_gradients,
    projected_axes,
    scales_of,
    slopes_of,
)
from core.rasterizer.cuda.harmonics import basis, direction_gradient, load_sh, store_sh
from core.rasterizer.cuda.vectors import add, constants_3, cross, dot, scaled, store_3, subtract, unit
from core.rasterizer.cuda.view import FOCAL_X, FOCAL_Y, ROTATION

BLOCK, WARPS = 32, 1  # Gaussians per program, one per thread


@triton.jit(do_not_specialize=["count"])
def project_backward(
    means, quaternions, log_scales, logit_opacities, sh, view, footprints, tile_counts, sums,
    to_means, to_quaternions, to_log_scales, to_logit_opacities, to_sh, to_probe, count,
    COEFFICIENTS: tl.constexpr, PROBED: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Write dL/d(parameters) from the sums (N, SLOT_COLUMNS) over the pixels; zeros for what touches no tile.

    to_probe: written if PROBED.
    """
    row = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    known = row < count
    drawn = known & (tl.load(tile_counts + row, mask=known, other=0) > 0)
    mean, quaternion, log_scale, logit = parameters_of(means, quaternions, log_scales, logit_opacities, row, drawn)
    # What is not drawn may hold anything: it is computed as something harmless, and written as zero.
    quaternion = (tl.where(drawn, quaternion[0], 1.0), quaternion[1], quaternion[2], quaternion[3])
    offset = offset_from(view, mean)
    depth = tl.where(drawn, depth_of(view, offset), 1.0)

    at = sums + row * SLOT_COLUMNS
    to_offset, to_quaternion, to_log_scale, to_x, to_y = ellipse_backward(
        view, offset, depth, quaternion, log_scale, at, drawn
    )
    through_colour = colour_backward(row, offset, sh, footprints, at, to_sh, known, drawn, COEFFICIENTS)
    store_3(to_means, row, where_3(drawn, add(to_offset, through_colour)), known)
    store_3(to_log_scales, row, where_3(drawn, to_log_scale), known)
    for k in tl.static_range(4):
        tl.store(to_quaternions + 4 * row + k, tl.where(drawn, to_quaternion[k], 0.0), mask=known)
    # alpha = opacity * ...: the derivative of log(opacity) by its logit is 1 - opacity.
    to_logit = tl.load(at + SUM_G, mask=drawn, other=0.0) * (1.0 - opacity_of(logit))
    tl.store(to_logit_opacities + row, to_logit, mask=known)
    if PROBED:
        tl.store(to_probe + 2 * row, tl.where(drawn, to_x, 0.0), mask=known)
        tl.store(to_probe + 2 * row + 1, tl.where(drawn, to_y, 0.0), mask=known)


@triton.jit
def where_3(condition, a):
    """a where the condition holds, else zeros, whatever a is there."""
    return tl.where(condition, a[0], 0.0), tl.where(condition, a[1], 0.0), tl.where(condition, a[2], 0.0)


@triton.jit
def ellipse_backward(view, offset, depth, quaternion, log_scale, sums, drawn):
    """From the sums over the pixels to dL/d of offset, quaternion, log scales and centre (px).

    With A = c / det and m = b / c as in core.rasterizer.cpu.project_backward, whose sums cancel in float32 for a
    needle. Here the rows V_x, `across`, and V_y, `down`, of V = J W R S enter by q = V_y / c and by

        r = V_x - m V_y = q x (V_x x V_y) + blur V_x / c

    alone: dA = -2 A^2 r dV_x + 2 m A^2 r dV_y, dm = q dV_x + (r / c - m q) dV_y, d(1 / c) = -2 q / c dV_y. An axis that
    is stretched adds to its own entries of V, and one that turns to those of another: what comes of either is a `pull`,
    which is symmetric.
    """
    axis_x, axis_y = constants_3(view, ROTATION), constants_3(view, ROTATION + 3)
    axis_z = constants_3(view, ROTATION + 6)
    fx, fy = tl.load(view + FOCAL_X), tl.load(view + FOCAL_Y)
    inverse_depth, slope_x, slope_y, clamped_x, clamped_y = slopes_of(view, offset, depth)
    unit_quaternion, inverse_norm, axes = axes_of(quaternion)
    scales = scales_of(log_scale)
    x_gradient, y_gradient = pixel_gradients(view, inverse_depth, clamped_x, clamped_y)
    across, down = projected_axes(x_gradient, axes, scales), projected_axes(y_gradient, axes, scales)
    _, b, c, determinant = covariance(across, down)

    # log(alpha) = ... - A e^2 / 2 - dy^2 / (2 c), with e = dx - m dy.
    inverse_c = 1.0 / c
    precision, lean = c / determinant, b * inverse_c
    to_x = precision * tl.load(sums + SUM_GE, mask=drawn, other=0.0)
    to_y = inverse_c * tl.load(sums + SUM_GY, mask=drawn, other=0.0) - lean * to_x
    spread = precision * precision * -0.5 * tl.load(sums + SUM_GEE, mask=drawn, other=0.0)  # A^2 dL/dA
    to_lean = precision * tl.load(sums + SUM_GEY, mask=drawn, other=0.0)
    to_inverse_c = -0.5 * tl.load(sums + SUM_GYY, mask=drawn, other=0.0)

    q = scaled(inverse_c, down)
    r = add(cross(q, cross(across, down)), scaled(inverse_c * BLUR_PX2, across))
    by = spread, to_lean, to_inverse_c
    stretches = pull(r, q, 0, 0, by), pull(r, q, 1, 1, by), pull(r, q, 2, 2, by)
    turns = (
        pull(r, q, 1, 2, by) * (scales[1] / scales[2] - scales[2] / scales[1]),
        pull(r, q, 2, 0, by) * (scales[2] / scales[0] - scales[0] / scales[2]),
        pull(r, q, 0, 1, by) * (scales[0] / scales[1] - scales[1] / scales[0]),
    )
    to_log_scale = (
        log_scale_gradient(log_scale[0], stretches[0]),
        log_scale_gradient(log_scale[1], stretches[1]),
        log_scale_gradient(log_scale[2], stretches[2]),
    )
    to_quaternion = quaternion_gradient(unit_quaternion, inverse_norm, turns)

    # The centre moves with the slopes; the rows of J W too where they are not clamped, and with the depth, which
    # shrinks all axes.
    to_across = subtract(scaled(to_lean, q), scaled(2.0 * spread, r))
    to_down = subtract(
        scaled(2.0 * lean * spread + inverse_c * to_lean, r), scaled(lean * to_lean + 2.0 * inverse_c * to_inverse_c, q)
    )
    in_depth = projected_axes(axis_z, axes, scales)
    to_slope_x, to_slope_y = fx * to_x, fy * to_y
    to_slope_x -= tl.where(clamped_x == slope_x, fx * inverse_depth * dot(to_across, in_depth), 0.0)
    to_slope_y -= tl.where(clamped_y == slope_y, fy * inverse_depth * dot(to_down, in_depth), 0.0)
    to_depth = stretches[0] + stretches[1] + stretches[2]
    to_depth += to_slope_x * slope_x + to_slope_y * slope_y
    in_picture = add(scaled(to_slope_x, axis_x), scaled(to_slope_y, axis_y))
    to_offset = scaled(inverse_depth, subtract(in_picture, scaled(to_depth, axis_z)))
    return to_offset, to_quaternion, to_log_scale, to_x, to_y


@triton.jit
def pull(r, q, i: tl.constexpr, j: tl.constexpr, by):
    """dL/d(axis i's entries of V) times axis j's. by: A^2 dL/dA, dL/dm and dL/d(1 / c)."""
    spread, to_lean, to_inverse_c = by
    return to_lean * (q[i] * r[j] + r[i] * q[j]) - 2.0 * (spread * r[i] * r[j] + to_inverse_c * q[i] * q[j])


@triton.jit
def log_scale_gradient(log_scale, gradient):
    """Zero where the log scale was clamped."""
    return tl.where((log_scale >= LEAST_LOG_SCALE) & (log_scale <= MOST_LOG_SCALE), gradient, 0.0)


@triton.jit
def quaternion_gradient(unit_quaternion, inverse_norm, turns):
    """From dL/d(turns about the ellipsoid's own axes, radians) to dL/d(quaternion), its normalisation included:
    its change dq turns by 2 q* dq."""
    w, x, y, z = unit_quaternion
    first, second, third = scaled(2.0 * inverse_norm, turns)
    return (
        -x * first - y * second - z * third,
        w * first - z * second + y * third,
        z * first + w * second - x * third,
        x * second - y * first + w * third,
    )


@triton.jit
def colour_backward(row, offset, sh, footprints, sums, to_sh, known, drawn, COEFFICIENTS: tl.constexpr):
    """Write dL/d(sh); dL/d(offset) by way of the direction."""
    direction, inverse_distance = unit(offset)
    terms = basis(direction, COEFFICIENTS)
    at = footprints + row * footprint.COLUMNS
    # A colour that was clamped at zero has no gradient.
    red = tl.where(tl.load(at + footprint.RED, mask=drawn, other=0.0) > 0, tl.load(sums + SUM_RED, mask=drawn), 0.0)
    green = tl.where(
        tl.load(at + footprint.GREEN, mask=drawn, other=0.0) > 0, tl.load(sums + SUM_GREEN, mask=drawn), 0.0
    )
    blue = tl.where(tl.load(at + footprint.BLUE, mask=drawn, other=0.0) > 0, tl.load(sums + SUM_BLUE, mask=drawn), 0.0)
    store_sh(to_sh, row, terms, (red, green, blue), known, COEFFICIENTS)
    coefficients, to_basis = load_sh(sh, row, drawn, COEFFICIENTS), ()
    for k in tl.static_range(COEFFICIENTS):
        to_basis = to_basis + (dot(coefficients[k], (red, green, blue)),)
    to_direction = direction_gradient(to_basis, direction, COEFFICIENTS)
    radial = dot(to_direction, direction)
    return scaled(inverse_distance, subtract(to_direction, scaled(radial, direction)))
