"""The picture loss of core.training.losses.photometric, fused, for float32 on a CPU.

One pass over the rows computes the three windowed means that depend on the render, the error, and the derivatives of
SSIM by those means; the backward pass blurs the derivatives, because the window is its own adjoint:

    dL/dx = w (1 - s) sign(x - y) / (3 V) + blur(D_mean) + 2 x blur(D_square) + y blur(D_product)

Plain loops, shaped so that LLVM vectorises them along a row: planes instead of interleaved colours, few arrays per
loop, zeros around the picture so that nothing branches. A row is computed on its own and sums are formed afterwards in
one order, so results do not depend on the number of threads.
"""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from core.kernels.compiled import kernel, part
from core.system.threads import in_parallel
from core.training.losses.photometric import C1, C2, RADIUS, WINDOW, Target, window

BLOCK_PIXELS = 10_000  # a block of work: a quarter of a millisecond
assert WINDOW == 11  # `_down` and `_along` are written out for it
_TAPS = tuple(np.float32(tap) for tap in window()[: RADIUS + 1])
_K0, _K1, _K2, _K3, _K4, _K5 = _TAPS
_C1, _C2 = np.float32(C1), np.float32(C2)
_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)
_HALF, _THIRD = np.float32(0.5), np.float32(1 / 3)


def photometric_cpu(
    image: Float[Tensor, "h w 3"], target: Target, weight: Float[Tensor, "h w"] | None, ssim_weight: float
) -> Float[Tensor, ""]:
    """`core.training.losses.photometric.photometric` for float32 on the CPU."""
    return _Photometric.apply(image, target, weight, ssim_weight)


class _Photometric(torch.autograd.Function):
    @staticmethod
    def forward(ctx, image, target, weight, ssim_weight):
        height, width = image.shape[:2]
        pixels = image.detach().numpy().transpose(2, 0, 1)
        x = np.zeros((3, height + 2 * RADIUS, width), np.float32)
        x[:, RADIUS:-RADIUS] = pixels if target.valid is None else np.where(target.valid.numpy(), pixels, _ZERO)
        weights = np.ones((height, width), np.float32) if weight is None else weight.detach().contiguous().numpy()
        if target.valid is not None:
            weights = weights * target.valid.numpy()
        y, mean, mean_square = target.padded.numpy(), target.mean.numpy(), target.mean_square.numpy()
        slopes = np.empty((3, 3, height + 2 * RADIUS, width), np.float32)
        slopes[:, :, :RADIUS] = 0
        slopes[:, :, -RADIUS:] = 0
        error = np.empty((height, width), np.float32)
        ssim_weight = np.float32(ssim_weight)
        scale = np.float32(1 / (3 * target.valid_pixels))

        def rows(begin: int, end: int) -> None:
            _forward_rows(x, y, mean, mean_square, weights, ssim_weight, scale, begin, end, error, slopes)

        in_parallel(rows, height, max(1, BLOCK_PIXELS // width))
        ctx.state = (x, y, weights, slopes, ssim_weight, scale, target.valid)
        loss = float(np.sum(error * weights, dtype=np.float64)) / target.valid_pixels
        return torch.tensor(loss, dtype=torch.float32)

    @staticmethod
    @once_differentiable
    def backward(ctx, loss_gradient):
        x, y, weights, slopes, ssim_weight, scale, valid = ctx.state
        height, width = weights.shape
        gradient = np.empty((height, width, 3), np.float32)
        factor = np.float32(loss_gradient)

        def rows(begin: int, end: int) -> None:
            _backward_rows(x, y, weights, slopes, ssim_weight, scale, factor, begin, end, gradient)

        in_parallel(rows, height, max(1, BLOCK_PIXELS // width))
        if valid is not None:
            gradient[~valid.numpy()] = 0
        return torch.from_numpy(gradient), None, None, None


@part
def _down(plane, row, i):
    """The window down column i, from `row` on."""
    outer = _K0 * (plane[row, i] + plane[row + 10, i]) + _K1 * (plane[row + 1, i] + plane[row + 9, i])
    inner = _K2 * (plane[row + 2, i] + plane[row + 8, i]) + _K3 * (plane[row + 3, i] + plane[row + 7, i])
    return outer + inner + _K4 * (plane[row + 4, i] + plane[row + 6, i]) + _K5 * plane[row + 5, i]


@part
def _along(line, i):
    """The window along a line, from i on."""
    outer = _K0 * (line[i] + line[i + 10]) + _K1 * (line[i + 1] + line[i + 9])
    inner = _K2 * (line[i + 2] + line[i + 8]) + _K3 * (line[i + 3] + line[i + 7])
    return outer + inner + _K4 * (line[i + 4] + line[i + 6]) + _K5 * line[i + 5]


@kernel
def _forward_rows(x, y, y_mean, y_mean_square, weights, ssim_weight, scale, begin, end, error, slopes):
    """Write rows begin..end of the error (height, width), a mean over channels, and of its slopes (3 products,
    3 channels, height + 10, width).

    slopes: the derivatives of the loss by blur(x), blur(x^2) and blur(x y). scale: 1 / (3 V).
    """
    width = weights.shape[1]
    lines = np.zeros((3, width + 2 * RADIUS), np.float32)
    for row in range(begin, end):
        error[row] = _ZERO
        for channel in range(3):
            _blur_products(x[channel], y[channel], row, lines)
            _compare(
                lines, x[channel, row + RADIUS], y[channel, row + RADIUS],
                y_mean[channel, row], y_mean_square[channel, row],
                weights[row], ssim_weight, scale, error[row],
                slopes[0, channel, row + RADIUS], slopes[1, channel, row + RADIUS], slopes[2, channel, row + RADIUS],
            )  # fmt: skip


@part
def _blur_products(x, y, row, lines):
    """The window down every column of x, x^2 and x y, from `row` on, into the middle of three padded lines."""
    width = x.shape[1]
    means = lines[0, RADIUS : RADIUS + width]
    squares = lines[1, RADIUS : RADIUS + width]
    products = lines[2, RADIUS : RADIUS + width]
    means[:] = _ZERO
    squares[:] = _ZERO
    products[:] = _ZERO
    for tap in range(RADIUS):
        first, last = row + tap, row + 2 * RADIUS - tap
        _add_rows(_TAPS[tap], x[first], x[last], y[first], y[last], means, squares, products)
    # The middle row, as two halves of itself.
    _add_rows(_HALF * _K5, x[row + RADIUS], x[row + RADIUS], y[row + RADIUS], y[row + RADIUS], means, squares, products)


@part
def _add_rows(tap, x, x_mirror, y, y_mirror, means, squares, products):
    """Adds two rows that share a tap. Written out over all eleven rows at once, LLVM gives up on vectors."""
    for i in range(x.shape[0]):
        a, b = x[i], x_mirror[i]
        means[i] += tap * (a + b)
        squares[i] += tap * (a * a + b * b)
        products[i] += tap * (a * y[i] + b * y_mirror[i])


@part
def _compare(lines, x, y, y_means, y_squares, weights, ssim_weight, scale, error, by_mean, by_square, by_product):
    """One row of one channel: adds to `error`, and the derivatives of the loss by blur(x), blur(x^2) and blur(x y)."""
    means, squares, products = lines[0], lines[1], lines[2]
    for i in range(x.shape[0]):
        x_mean, y_mean = _along(means, i), y_means[i]
        x_variance = _along(squares, i) - x_mean * x_mean
        y_variance = y_squares[i] - y_mean * y_mean
        covariance = _along(products, i) - x_mean * y_mean
        likeness = _TWO * x_mean * y_mean + _C1
        structure = _TWO * covariance + _C2
        brightness = x_mean * x_mean + y_mean * y_mean + _C1
        contrast = x_variance + y_variance + _C2
        inverse = _ONE / (brightness * contrast)
        similarity = likeness * structure * inverse
        error[i] += _THIRD * ((_ONE - ssim_weight) * abs(x[i] - y[i]) + ssim_weight * (_ONE - similarity))
        slope = -ssim_weight * scale * weights[i]
        product = _TWO * likeness * inverse
        square = -similarity * brightness * inverse
        mean = _TWO * inverse * (y_mean * structure - x_mean * similarity * contrast)
        by_mean[i] = slope * (mean - y_mean * product - _TWO * x_mean * square)
        by_square[i] = slope * square
        by_product[i] = slope * product


@kernel
def _backward_rows(x, y, weights, slopes, ssim_weight, scale, factor, begin, end, gradient):
    """Write rows begin..end of dL/dx (height, width, 3). slopes, scale: as in `_forward_rows`.
    factor: the gradient that arrives at the loss."""
    width = weights.shape[1]
    lines = np.zeros((3, width + 2 * RADIUS), np.float32)
    line = np.empty(width, np.float32)
    for row in range(begin, end):
        for channel in range(3):
            for k in range(3):
                _blur_down(slopes[k, channel], row, lines[k, RADIUS:])
            _combine(
                lines,
                x[channel, row + RADIUS],
                y[channel, row + RADIUS],
                weights[row],
                (_ONE - ssim_weight) * scale,
                factor,
                line,
            )
            for i in range(width):
                gradient[row, i, channel] = line[i]


@part
def _blur_down(plane, row, line):
    for i in range(plane.shape[1]):
        line[i] = _down(plane, row, i)


@part
def _combine(lines, x, y, weights, scale, factor, line):
    means, squares, products = lines[0], lines[1], lines[2]
    for i in range(x.shape[0]):
        a, b = x[i], y[i]
        sign = _ONE if a > b else (-_ONE if a < b else _ZERO)
        slope = _along(means, i) + _TWO * a * _along(squares, i) + b * _along(products, i)
        line[i] = factor * (scale * weights[i] * sign + slope)
