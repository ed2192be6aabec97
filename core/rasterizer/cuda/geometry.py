"""From a Gaussian's parameters to its ellipse: what projecting and its gradient share.
The definition is the reference."""

import triton
import triton.language as tl

from core.rasterizer import contract, layout
from core.rasterizer.cuda.vectors import constants_3, cross, dot, load_3, scaled, subtract
from core.rasterizer.cuda.view import (
    BOTTOM,
    CENTRE,
    CENTRE_REST,
    FOCAL_X,
    FOCAL_Y,
    HEIGHT,
    LEFT,
    MIDDLE_X,
    MIDDLE_Y,
    RIGHT,
    ROTATION,
    TOP,
    WIDTH,
)
from core.scene import splats

NEAR = tl.constexpr(contract.NEAR)
BLUR_PX2 = tl.constexpr(contract.BLUR_PX2)
ALPHA_MIN = tl.constexpr(contract.ALPHA_MIN)
QUATERNION_MIN_NORM2 = tl.constexpr(splats.QUATERNION_MIN_NORM2)
LEAST_LOGIT = tl.constexpr(contract.LEAST_LOGIT)
LEAST_LOG_SCALE, MOST_LOG_SCALE = (tl.constexpr(limit) for limit in contract.LOG_SCALE_RANGE)
HALF_LOG2_E = tl.constexpr(layout.HALF_LOG2_E)


@triton.jit
def parameters_of(means, quaternions, log_scales, logit_opacities, row, known):
    """Mean, quaternion (w x y z), log scales and logit opacity of Gaussian `row`, zeros where `known` is false."""
    at = quaternions + 4 * row
    quaternion = (
        tl.load(at, mask=known, other=0.0),
        tl.load(at + 1, mask=known, other=0.0),
        tl.load(at + 2, mask=known, other=0.0),
        tl.load(at + 3, mask=known, other=0.0),
    )
    logit = tl.load(logit_opacities + row, mask=known, other=0.0)
    return load_3(means, row, known), quaternion, load_3(log_scales, row, known), logit


@triton.jit
def offset_from(view, mean):
    """The mean in world axes, from the camera. Subtracted before anything is rotated:
    far from the origin float32 needs it."""
    return subtract(subtract(mean, constants_3(view, CENTRE)), constants_3(view, CENTRE_REST))


@triton.jit
def norm2_of(quaternion):
    w, x, y, z = quaternion
    return w * w + x * x + y * y + z * z


@triton.jit
def can_be_projected(offset, quaternion, log_scale, logit, depth):
    """Whether a Gaussian is finite (its SH apart), in front of the camera,
    rotated by a valid quaternion, not too faint.

    Every test is written so that NaN fails it, and so do finite numbers whose squares overflow.
    """
    distance2, norm2 = dot(offset, offset), norm2_of(quaternion)
    # 0 times NaN or infinity is NaN; a sum of the numbers themselves could overflow where all are finite.
    zeros = 0.0 * distance2 + 0.0 * norm2 + 0.0 * logit
    zeros += 0.0 * log_scale[0] + 0.0 * log_scale[1] + 0.0 * log_scale[2]
    return (depth > NEAR) & (zeros == 0.0) & (norm2 >= QUATERNION_MIN_NORM2) & (logit >= LEAST_LOGIT)


@triton.jit
def axes_of(quaternion):
    """The unit quaternion, the inverse of its norm, and its rotation's columns: the ellipsoid's axes."""
    inverse_norm = 1.0 / tl.sqrt_rn(norm2_of(quaternion))
    w, x, y, z = quaternion
    w, x, y, z = w * inverse_norm, x * inverse_norm, y * inverse_norm, z * inverse_norm
    first = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
    second = (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x))
    third = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
    return (w, x, y, z), inverse_norm, (first, second, third)


@triton.jit
def clamped(number, least, most):
    return tl.minimum(tl.maximum(number, least), most)


@triton.jit
def scales_of(log_scale):
    """The standard deviations along the axes."""
    return (
        tl.exp(clamped(log_scale[0], LEAST_LOG_SCALE, MOST_LOG_SCALE)),
        tl.exp(clamped(log_scale[1], LEAST_LOG_SCALE, MOST_LOG_SCALE)),
        tl.exp(clamped(log_scale[2], LEAST_LOG_SCALE, MOST_LOG_SCALE)),
    )


@triton.jit
def opacity_of(logit):
    """In [0, 1]."""
    return 1.0 / (1.0 + tl.exp(-logit))


@triton.jit
def depth_of(view, offset):
    """Along the optical axis, scene units."""
    return dot(constants_3(view, ROTATION + 6), offset)


@triton.jit
def slopes_of(view, offset, depth):
    """The inverse depth, x / z and y / z, and the latter two clamped to the view's limits,
    which is for the Jacobian only."""
    inverse_depth = 1.0 / depth
    x = inverse_depth * dot(constants_3(view, ROTATION), offset)
    y = inverse_depth * dot(constants_3(view, ROTATION + 3), offset)
    clamped_x = clamped(x, tl.load(view + LEFT), tl.load(view + RIGHT))
    clamped_y = clamped(y, tl.load(view + TOP), tl.load(view + BOTTOM))
    return inverse_depth, x, y, clamped_x, clamped_y


@triton.jit
def pixel_gradients(view, inverse_depth, clamped_x, clamped_y):
    """How the pixel coordinates x and y move with a point of the world: the rows of J W."""
    axis_z = constants_3(view, ROTATION + 6)
    across = subtract(constants_3(view, ROTATION), scaled(clamped_x, axis_z))
    down = subtract(constants_3(view, ROTATION + 3), scaled(clamped_y, axis_z))
    return (
        scaled(tl.load(view + FOCAL_X) * inverse_depth, across),
        scaled(tl.load(view + FOCAL_Y) * inverse_depth, down),
    )


@triton.jit
def projected_axes(gradient, axes, scales):
    """The Gaussian's axes along a picture axis, px: a row of the factor V = J W R S of the 2D covariance V V'."""
    return scales[0] * dot(gradient, axes[0]), scales[1] * dot(gradient, axes[1]), scales[2] * dot(gradient, axes[2])


@triton.jit
def covariance(across, down):
    """The entries a, b, c of V V' + blur and its determinant, px^2 and px^4."""
    a, b, c = dot(across, across), dot(across, down), dot(down, down)
    # det(V V' + e I) from the factor: the difference a c - b^2 is nothing but rounding for a needle.
    normal = cross(across, down)
    determinant = dot(normal, normal) + (a + c + BLUR_PX2) * BLUR_PX2
    return a + BLUR_PX2, b, c + BLUR_PX2, determinant


@triton.jit
def ellipse(view, offset, depth, quaternion, log_scale):
    """Centre (px) and covariance entries a, b, c, determinant of a Gaussian that passed `can_be_projected`."""
    inverse_depth, x, y, clamped_x, clamped_y = slopes_of(view, offset, depth)
    _, _, axes = axes_of(quaternion)
    scales = scales_of(log_scale)
    x_gradient, y_gradient = pixel_gradients(view, inverse_depth, clamped_x, clamped_y)
    a, b, c, determinant = covariance(
        projected_axes(x_gradient, axes, scales), projected_axes(y_gradient, axes, scales)
    )
    centre_x = tl.load(view + FOCAL_X) * x + tl.load(view + MIDDLE_X)
    centre_y = tl.load(view + FOCAL_Y) * y + tl.load(view + MIDDLE_Y)
    return centre_x, centre_y, a, b, c, determinant


@triton.jit
def level_of(opacity):
    """d' S^-1 d where opacity * exp(-d' S^-1 d / 2) has fallen to ALPHA_MIN; never 0, as its root is divided by."""
    return tl.maximum(tl.log2(opacity / ALPHA_MIN) / HALF_LOG2_E, 1e-6)


@triton.jit
def meets_picture(view, x, y, a, c, determinant, level):
    """Whether the box around an ellipse with centre x, y meets the picture; no for one beyond float32."""
    reach_x, reach_y = tl.sqrt_rn(level * a), tl.sqrt_rn(level * c)
    inside = (x + reach_x >= 0) & (x - reach_x <= tl.load(view + WIDTH))
    inside &= (y + reach_y >= 0) & (y - reach_y <= tl.load(view + HEIGHT))
    return inside & (0.0 * determinant == 0.0)
