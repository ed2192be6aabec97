"""The picture loss of core.training.losses.photometric, fused, for float32 on a GPU:
two launches forward and two backward.

The same two passes as in photometric_cpu, with its formula of the gradient. Every blur is one kernel down the columns
and one along the rows, which goes on with the result. One pixel per lane.
"""

import torch
import triton
import triton.language as tl
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from core.errors import BadInput
from core.kernels.triton_launch import FUSED, MOST_NUMBERS, USE_SMALLER, blocks
from core.training.losses import photometric

BLOCK = 128  # pixels per program, one per thread
RADIUS, WINDOW = tl.constexpr(photometric.RADIUS), tl.constexpr(photometric.WINDOW)
C1, C2 = tl.constexpr(photometric.C1), tl.constexpr(photometric.C2)
SIZES = ["height", "width"]  # Triton would compile anew for sizes that are multiples of 16
PLANES = 9  # three products of three channels


@triton.jit(do_not_specialize=SIZES)
def blur_products_down(x, y, taps, blurred, height, width, BLOCK: tl.constexpr):
    """The window down the columns of x, x^2 and x y (3, height, width) -> blurred (3 products, 3, height, width)."""
    size = height * width
    pixel, plane = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK), tl.program_id(1)
    row = pixel // width
    mean = tl.zeros((BLOCK,), dtype=tl.float32)
    square, product = mean, mean
    for tap in tl.static_range(WINDOW):
        inside = (row + (tap - RADIUS) >= 0) & (row + (tap - RADIUS) < height)
        there = plane * size + pixel + (tap - RADIUS) * width
        a = tl.load(x + there, mask=inside, other=0.0)
        weighted = a * tl.load(taps + tap)
        mean += weighted
        square += weighted * a
        product += weighted * tl.load(y + there, mask=inside, other=0.0)
    known = pixel < size
    tl.store(blurred + plane * size + pixel, mean, mask=known)
    tl.store(blurred + (3 + plane) * size + pixel, square, mask=known)
    tl.store(blurred + (6 + plane) * size + pixel, product, mask=known)


@triton.jit(do_not_specialize=SIZES)
def blur_down(planes, taps, blurred, height, width, BLOCK: tl.constexpr):
    """The window down the columns of as many planes as the grid has."""
    size = height * width
    pixel, plane = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK), tl.program_id(1)
    row = pixel // width
    total = tl.zeros((BLOCK,), dtype=tl.float32)
    for tap in tl.static_range(WINDOW):
        inside = (row + (tap - RADIUS) >= 0) & (row + (tap - RADIUS) < height)
        there = plane * size + pixel + (tap - RADIUS) * width
        total += tl.load(planes + there, mask=inside, other=0.0) * tl.load(taps + tap)
    tl.store(blurred + plane * size + pixel, total, mask=pixel < size)


@triton.jit
def blur_along(plane, taps, pixel, column, width, known):
    """The window along the rows, at the pixels."""
    total = tl.zeros_like(pixel).to(tl.float32)
    for tap in tl.static_range(WINDOW):
        inside = known & (column + (tap - RADIUS) >= 0) & (column + (tap - RADIUS) < width)
        total += tl.load(plane + pixel + (tap - RADIUS), mask=inside, other=0.0) * tl.load(taps + tap)
    return total


@triton.jit(do_not_specialize=SIZES)
def compare(
    blurred, x, y, y_means, y_squares, weights, taps, error, slopes, ssim_weight, height, width, BLOCK: tl.constexpr
):
    """The error (height, width), a mean over channels,
    and the derivatives (3 products, 3, height, width) of its weighted sum by the means."""
    size = height * width
    pixel = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    known, column = pixel < size, pixel % width
    slope = tl.load(weights + pixel, mask=known, other=0.0) * (-ssim_weight / 3)
    total = tl.zeros((BLOCK,), dtype=tl.float32)
    for channel in tl.static_range(3):
        x_mean = blur_along(blurred + channel * size, taps, pixel, column, width, known)
        x_square = blur_along(blurred + (3 + channel) * size, taps, pixel, column, width, known)
        product = blur_along(blurred + (6 + channel) * size, taps, pixel, column, width, known)
        at = channel * size + pixel
        y_mean = tl.load(y_means + at, mask=known, other=0.0)
        y_square = tl.load(y_squares + at, mask=known, other=0.0)
        likeness = 2 * x_mean * y_mean + C1
        structure = 2 * (product - x_mean * y_mean) + C2
        brightness = x_mean * x_mean + y_mean * y_mean + C1
        contrast = x_square - x_mean * x_mean + y_square - y_mean * y_mean + C2
        inverse = 1.0 / (brightness * contrast)
        similarity = likeness * structure * inverse
        difference = tl.load(x + at, mask=known, other=0.0) - tl.load(y + at, mask=known, other=0.0)
        total += tl.abs(difference) * (1 - ssim_weight) + (1 - similarity) * ssim_weight
        by_product = 2 * likeness * inverse
        by_square = -similarity * brightness * inverse
        by_mean = 2 * inverse * (y_mean * structure - x_mean * similarity * contrast)
        tl.store(slopes + at, slope * (by_mean - y_mean * by_product - 2 * x_mean * by_square), mask=known)
        tl.store(slopes + 3 * size + at, slope * by_square, mask=known)
        tl.store(slopes + 6 * size + at, slope * by_product, mask=known)
    tl.store(error + pixel, total / 3, mask=known)


@triton.jit(do_not_specialize=SIZES)
def combine(blurred, x, y, weights, taps, factor, gradient, ssim_weight, height, width, BLOCK: tl.constexpr):
    """dL/dx (height, width, 3) from the derivatives blurred down; factor:
    a number in memory, dL/d(weighted sum of errors)."""
    size = height * width
    pixel = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    known, column = pixel < size, pixel % width
    pull = tl.load(weights + pixel, mask=known, other=0.0) * ((1 - ssim_weight) / 3)
    for channel in tl.static_range(3):
        at = channel * size + pixel
        a, b = tl.load(x + at, mask=known, other=0.0), tl.load(y + at, mask=known, other=0.0)
        slope = tl.where(a > b, pull, tl.where(a < b, -pull, 0.0))
        slope += blur_along(blurred + channel * size, taps, pixel, column, width, known)
        slope += blur_along(blurred + (3 + channel) * size, taps, pixel, column, width, known) * 2 * a
        slope += blur_along(blurred + (6 + channel) * size, taps, pixel, column, width, known) * b
        tl.store(gradient + 3 * pixel + channel, slope * tl.load(factor), mask=known)


def photometric_cuda(
    image: Float[Tensor, "h w 3"],
    target: photometric.Target,
    weight: Float[Tensor, "h w"] | None,
    ssim_weight: float,
) -> Float[Tensor, ""]:
    """`core.training.losses.photometric.photometric` for float32 on a GPU; BadInput for a picture too large for it."""
    height, width = image.shape[:2]
    if PLANES * height * width >= MOST_NUMBERS:
        what = f"A photo of {width}x{height} px is larger than the picture loss can count on a GPU."
        raise BadInput(what, USE_SMALLER)
    return _Photometric.apply(image, target, weight, float(ssim_weight))


class _Photometric(torch.autograd.Function):
    @staticmethod
    def forward(ctx, image, target, weight, ssim_weight):
        height, width = image.shape[:2]
        x, y, valid = photometric.planes_of(image.detach(), target.valid), target.planes.contiguous(), target.valid
        weights = torch.ones_like(image[..., 0]) if weight is None else weight.detach()
        weights = (weights if valid is None else weights * valid).contiguous()
        taps = photometric.window(torch.float32, image.device)
        ctx.sizes = ssim_weight, height, width
        blurred, slopes = (image.new_empty(PLANES, height, width) for _ in range(2))
        error = image.new_empty(height, width)
        grid = blocks(height * width, BLOCK)
        blur_products_down[(*grid, 3)](x, y, taps, blurred, height, width, BLOCK=BLOCK, **FUSED)
        means = target.mean.contiguous(), target.mean_square.contiguous()
        compare[grid](blurred, x, y, *means, weights, taps, error, slopes, *ctx.sizes, BLOCK=BLOCK, **FUSED)
        ctx.save_for_backward(x, y, weights, taps, slopes)
        ctx.valid, ctx.valid_pixels = valid, target.valid_pixels
        return (error * weights).sum() / target.valid_pixels

    @staticmethod
    @once_differentiable
    def backward(ctx, loss_gradient):
        x, y, weights, taps, slopes = ctx.saved_tensors
        ssim_weight, height, width = ctx.sizes
        grid = blocks(height * width, BLOCK)
        blurred, gradient = torch.empty_like(slopes), x.new_empty(height, width, 3)
        blur_down[(*grid, PLANES)](slopes, taps, blurred, height, width, BLOCK=BLOCK, **FUSED)
        factor = loss_gradient / ctx.valid_pixels
        combine[grid](blurred, x, y, weights, taps, factor, gradient, ssim_weight, height, width, BLOCK=BLOCK, **FUSED)
        if ctx.valid is not None:
            gradient = torch.where(ctx.valid[..., None], gradient, 0)
        return gradient, None, None, None
