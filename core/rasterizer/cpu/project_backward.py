"""Gradients of the footprints back to the Gaussians' parameters: project.py read in reverse, in float64."""

import math

import numpy as np

from core.kernels.compiled import kernel, part
from core.rasterizer import layout
from core.rasterizer.cpu.harmonics import direction_gradient, fill_basis
from core.rasterizer.cpu.project import (
    LEAST_LOG_SCALE,
    MOST_LOG_SCALE,
    axes_of,
    covariance,
    opacity_of,
    pixel_gradient,
    projected_axes,
    scales_of,
    slopes_of,
)
from core.rasterizer.cpu.vectors import add, dot, row, scaled, subtract


@kernel
def project_backward(
    begin, end, means, quaternions, log_scales, logit_opacities, sh, rotation, centre, lens, limits,
    footprints, slot_starts, drawn_chunks, slot_gradients,
    to_means, to_quaternions, to_log_scales, to_logit_opacities, to_sh, to_probe,
):  # fmt: skip
    """Sum the slots' gradients of the Gaussians `begin` to `end`, one at a time, and write dL/d(parameters);
    zeros for what was not drawn.

    to_probe: empty where it is not wanted.
    """
    basis = np.empty(16)
    sums = np.empty(layout.SLOT_COLUMNS)
    for i in range(begin, end):
        if not add_up(slot_starts[i], slot_starts[i + 1], drawn_chunks, slot_gradients, sums):
            write_zeros(i, to_means, to_quaternions, to_log_scales, to_logit_opacities, to_sh, to_probe)
            continue
        offset = subtract(row(means, i), centre)
        to_offset = ellipse_backward(
            i, offset, quaternions, log_scales, rotation, lens, limits, sums,
            to_quaternions, to_log_scales, to_probe,
        )  # fmt: skip
        through_colour = colour_backward(i, offset, sh, basis, footprints, sums, to_sh)
        to_offset = add(to_offset, through_colour)
        to_means[i, 0], to_means[i, 1], to_means[i, 2] = to_offset
        # alpha = opacity * ...: the derivative of log(opacity) by its logit is 1 - opacity.
        to_logit_opacities[i] = sums[layout.SUM_G] * (1.0 - opacity_of(logit_opacities[i]))


@part
def add_up(begin, end, drawn_chunks, slot_gradients, sums):
    """Sum slots begin..end, those drawn, into `sums`; whether there was one."""
    drawn = False
    sums[:] = 0
    for slot in range(begin, end):
        if drawn_chunks[slot] != 0:
            drawn = True
            for k in range(layout.SLOT_COLUMNS):
                sums[k] += slot_gradients[slot, k]
    return drawn


@part
def write_zeros(i, to_means, to_quaternions, to_log_scales, to_logit_opacities, to_sh, to_probe):
    to_means[i], to_quaternions[i], to_log_scales[i], to_logit_opacities[i], to_sh[i] = 0, 0, 0, 0, 0
    if len(to_probe) > 0:
        to_probe[i] = 0


@part
def ellipse_backward(
    i, offset, quaternions, log_scales, rotation, lens, limits, sums, to_quaternions, to_log_scales, to_probe
):
    """From the sums over the pixels to quaternion, log scales and probe, written, and dL/d(offset), returned."""
    fx, fy, _, _ = lens
    axis_x, axis_y, axis_z = row(rotation, 0), row(rotation, 1), row(rotation, 2)
    inverse_depth, slope_x, slope_y, clamped_x, clamped_y = slopes_of(offset, rotation, limits)
    zoom_x, zoom_y = fx * inverse_depth, fy * inverse_depth
    unit, inverse_norm, axes = axes_of(quaternions, i)
    scales = scales_of(log_scales, i)
    x_gradient = pixel_gradient(rotation, 0, zoom_x, clamped_x)
    y_gradient = pixel_gradient(rotation, 1, zoom_y, clamped_y)
    across, down = projected_axes(x_gradient, axes, scales), projected_axes(y_gradient, axes, scales)
    _, b, c, determinant = covariance(across, down)

    # log(alpha) = ... - A e^2 / 2 - dy^2 / (2 c), with e = dx - m dy, A = c / det and m = b / c.
    inverse_c = 1.0 / c
    precision, lean = c / determinant, b * inverse_c
    to_x = precision * sums[layout.SUM_GE]
    to_y = inverse_c * sums[layout.SUM_GY] - lean * to_x
    to_precision = -0.5 * sums[layout.SUM_GEE]
    to_lean = precision * sums[layout.SUM_GEY]
    to_inverse_c = -0.5 * sums[layout.SUM_GYY]
    # dA = -A^2 (da - 2 m db + m^2 dc): in this form the determinant appears in A alone.
    spread = precision * precision * to_precision
    to_a = -spread
    to_b = 2.0 * lean * spread + inverse_c * to_lean
    to_c = -lean * lean * spread - inverse_c * (lean * to_lean + inverse_c * to_inverse_c)

    # The covariance is V V' + blur with rows `across` and `down` of V.
    to_across = add(scaled(2.0 * to_a, across), scaled(to_b, down))
    to_down = add(scaled(2.0 * to_c, down), scaled(to_b, across))
    # An axis that is stretched adds to its own entries of V, and one that turns to those of another.
    stretches = (
        pull(0, 0, to_across, to_down, across, down),
        pull(1, 1, to_across, to_down, across, down),
        pull(2, 2, to_across, to_down, across, down),
    )
    turns = (
        pull(1, 2, to_across, to_down, across, down) * (scales[1] / scales[2] - scales[2] / scales[1]),
        pull(2, 0, to_across, to_down, across, down) * (scales[2] / scales[0] - scales[0] / scales[2]),
        pull(0, 1, to_across, to_down, across, down) * (scales[0] / scales[1] - scales[1] / scales[0]),
    )
    for k in range(3):
        to_log_scales[i, k] = stretches[k] if LEAST_LOG_SCALE <= log_scales[i, k] <= MOST_LOG_SCALE else 0.0
    write_quaternion_gradient(i, unit, inverse_norm, turns, to_quaternions)
    if len(to_probe) > 0:
        to_probe[i, 0], to_probe[i, 1] = to_x, to_y

    # The centre moves with the slopes; the rows of J W too where they are not clamped, and with the depth, which
    # shrinks all axes.
    in_depth = projected_axes(axis_z, axes, scales)
    to_slope_x, to_slope_y = fx * to_x, fy * to_y
    if clamped_x == slope_x:
        to_slope_x -= zoom_x * dot(to_across, in_depth)
    if clamped_y == slope_y:
        to_slope_y -= zoom_y * dot(to_down, in_depth)
    to_depth = stretches[0] + stretches[1] + stretches[2] + to_slope_x * slope_x + to_slope_y * slope_y
    in_picture = add(scaled(to_slope_x, axis_x), scaled(to_slope_y, axis_y))
    return scaled(inverse_depth, subtract(in_picture, scaled(to_depth, axis_z)))


@part
def pull(i, j, to_across, to_down, across, down):
    """dL/d(axis i's entries of V) times axis j's."""
    return to_across[i] * across[j] + to_down[i] * down[j]


@part
def write_quaternion_gradient(i, unit, inverse_norm, turns, to_quaternions):
    """From dL/d(turns about the ellipsoid's own axes, radians) to dL/d(quaternion), its normalisation included:
    its change dq turns by 2 q* dq."""
    w, x, y, z = unit
    first, second, third = scaled(2.0 * inverse_norm, turns)
    to_quaternions[i, 0] = -x * first - y * second - z * third
    to_quaternions[i, 1] = w * first - z * second + y * third
    to_quaternions[i, 2] = z * first + w * second - x * third
    to_quaternions[i, 3] = x * second - y * first + w * third


@part
def colour_backward(i, offset, sh, basis, footprints, sums, to_sh):
    """Write dL/d(sh); dL/d(offset) by way of the direction. basis: room for 16 numbers; ends as dL/d(basis)."""
    distance = math.sqrt(dot(offset, offset))
    direction = scaled(1.0 / distance, offset)
    fill_basis(basis, direction, sh.shape[1])
    # A colour that the forward pass clamped at zero has no gradient.
    red = sums[layout.SUM_RED] if footprints[i, layout.RED] > 0 else 0.0
    green = sums[layout.SUM_GREEN] if footprints[i, layout.GREEN] > 0 else 0.0
    blue = sums[layout.SUM_BLUE] if footprints[i, layout.BLUE] > 0 else 0.0
    for k in range(sh.shape[1]):
        to_sh[i, k, 0] = basis[k] * red
        to_sh[i, k, 1] = basis[k] * green
        to_sh[i, k, 2] = basis[k] * blue
        basis[k] = sh[i, k, 0] * red + sh[i, k, 1] * green + sh[i, k, 2] * blue
    to_direction = direction_gradient(basis, direction, sh.shape[1])
    radial = dot(to_direction, direction)
    return scaled(1.0 / distance, subtract(to_direction, scaled(radial, direction)))
