"""The picture loss: weighted L1 and SSIM between a render and a photo.

    loss = sum over valid pixels p and channels c of  w_p ((1 - s) |x - y| + s (1 - SSIM(x, y)))_pc  /  (3 V)

V is the number of valid pixels, whatever the weights: a mask that hides half of a photo halves its loss, so hidden
pixels do not make the visible ones count more. SSIM is that of the original 3DGS: an 11 x 11 Gaussian window of sigma
1.5, constants 0.01^2 and 0.03^2 for a range of 1, and zeros beyond the picture. Invalid pixels are beyond the picture:
zero on both sides. Paper: eq. 20 (lambda_ssim = 0.2 is `ssim_weight`, lambda_1 = 0.8 the rest). This module is
the definition, in any dtype on any device; float32 goes through core.training.losses.photometric_cpu on a CPU and
photometric_cuda on a GPU, which equal it.
"""

from copy import copy
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from core.errors import BadInput
from core.evaluation.metrics import C1, C2, SIGMA, WINDOW
from core.rasterizer import Colour
from core.system.device import CPU, sent

RADIUS = WINDOW // 2


@cache
def window(dtype: torch.dtype = torch.float64, device: torch.device = CPU) -> Float[Tensor, " 11"]:
    """The Gaussian window along one axis; sums to 1."""
    return torch.from_numpy(cv2.getGaussianKernel(WINDOW, SIGMA)[:, 0]).to(device, dtype)


def blur(planes: Float[Tensor, "c h w"]) -> Float[Tensor, "c h w"]:
    """The planes convolved with the Gaussian window, zeros beyond the picture."""
    taps = window(planes.dtype, planes.device)
    if planes.dtype == torch.float32 and planes.device.type == "cpu" and not planes.requires_grad:
        # The same but for a last bit, in a twentieth of the time: photos that do not fit into the cache are blurred at
        # every step.
        along = taps.numpy()
        blurred = [cv2.sepFilter2D(plane, -1, along, along, borderType=cv2.BORDER_CONSTANT) for plane in planes.numpy()]
        return torch.from_numpy(np.stack(blurred))
    count = len(planes)
    taps = taps.expand(count, 1, WINDOW)
    # A batch of planes would take ten times as long.
    rows = F.conv2d(planes[None], taps[..., None], padding=(RADIUS, 0), groups=count)
    return F.conv2d(rows, taps[:, :, None], padding=(0, RADIUS), groups=count)[0]


class EmptyShare(NamedTuple):
    """How much of each pixel of a photo is empty, e in [0, 1], zero where it is invalid."""

    padded: Tensor  # (1, H + 10, W), e between RADIUS rows of zeros on either side
    mean: Tensor  # (1, H, W), the windowed mean of e
    mean_square: Tensor  # (1, H, W), the windowed mean of e^2
    mean_product: Tensor  # (3, H, W), the windowed mean of e times the photo's planes


class Target:
    """A photo as the loss sees it, with what is constant of it computed once.

    picture: (H, W, 3) in [0, 1]. valid: (H, W), False where the photo shows nothing (the rim of an undistorted photo).
    empty: (H, W) in [0, 1], the share of white in the picture that stands for the background; the target is over black
    until `over` is asked for. Raises BadInput for a photo without a valid pixel.

    What it holds, all with the dtype and the device of `picture`:
    planes: (3, H, W), zero where invalid.
    padded: (3, H + 10, W), planes between RADIUS rows of zeros on either side.
    mean, mean_square: (3, H, W), the windowed mean of planes and of planes^2.
    empty_share: None where nothing is empty, or once it is over a background.
    valid_pixels: V, a number or a tensor ().
    """

    def __init__(
        self,
        picture: Float[Tensor, "h w 3"],
        valid: Bool[Tensor, "h w"] | None = None,
        empty: Float[Tensor, "h w"] | None = None,
    ):
        self.valid = None if valid is None or bool(valid.all()) else valid
        self.empty_share = None
        if empty is not None:
            picture = (picture - empty[..., None]).clamp(min=0)  # both are rounded to 8 bits
        self._set_planes(planes_of(picture, self.valid))
        if empty is not None:
            plane = planes_of(empty[..., None], self.valid)
            padded = F.pad(plane, (0, 0, RADIUS, RADIUS))
            self.empty_share = EmptyShare(padded, blur(plane), blur(plane**2), blur(plane * self.planes))
        self.valid_pixels: int | Tensor = (
            picture.shape[0] * picture.shape[1] if self.valid is None else int(self.valid.sum())
        )
        if self.valid_pixels == 0:
            raise BadInput("A photo has no valid pixel to compare a render with.", "Remove it from the collection.")

    def _set_planes(self, planes: Float[Tensor, "3 h w"]) -> None:
        """Take over the planes, and compute what is constant of them."""
        self.padded = F.pad(planes, (0, 0, RADIUS, RADIUS))
        self.mean = blur(self.planes)
        self.mean_square = blur(self.planes**2)

    @property
    def planes(self) -> Float[Tensor, "3 h w"]:
        return self.padded[:, RADIUS:-RADIUS]

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        """All that has a value for each pixel."""
        return (
            self.padded,
            self.mean,
            self.mean_square,
            *(self.empty_share or ()),
            *(() if self.valid is None else (self.valid,)),
        )

    @property
    def nbytes(self) -> int:
        """Bytes of memory that its `tensors` take."""
        return sum(tensor.nbytes for tensor in self.tensors)

    def to_cells(self, planes: Float[Tensor, "3 H W"], height: int, width: int) -> Float[Tensor, "3 h w"]:
        """Planes of the photo's size averaged down to as many cells."""
        return F.interpolate(planes[None], size=(height, width), mode="area")[0]

    def to_pixels(self, cells: Float[Tensor, "1 h w"]) -> Float[Tensor, "H W"]:
        """Cells, such as those of a mask, enlarged to the photo's size, bilinearly."""
        return F.interpolate(cells[None], size=self.planes.shape[1:], mode="bilinear", align_corners=False)[0, 0]

    def masked(self, mask: Float[Tensor, "h w"]) -> "Target":
        """The photo times a mask, the same pixels valid."""
        other = copy(self)
        other._set_planes(self.planes * mask)
        other.empty_share = None
        return other

    def brightened(self, gain: Float[Tensor, "3"]) -> "Target":
        """The photo with each channel times `gain` (not clamped at 1); its statistics follow without another blur."""
        other = copy(self)
        gain = gain.to(self.planes)[:, None, None]
        other.padded = self.padded * gain
        other.mean, other.mean_square = self.mean * gain, self.mean_square * gain**2
        if self.empty_share is not None:
            other.empty_share = self.empty_share._replace(mean_product=self.empty_share.mean_product * gain)
        return other

    def over(self, background: Colour) -> "Target":
        """The photo over a colour, which shows where it is empty; its statistics follow without another blur."""
        if (empty := self.empty_share) is None:
            return self
        other = copy(self)
        colour = sent(self.padded.new_tensor(background, device=CPU), self.padded.device)[:, None, None]
        other.padded = self.padded + colour * empty.padded
        other.mean = self.mean + colour * empty.mean
        other.mean_square = self.mean_square + 2 * colour * empty.mean_product + colour**2 * empty.mean_square
        other.empty_share = None
        return other


def photometric(
    image: Float[Tensor, "h w 3"], target: Target, weight: Float[Tensor, "h w"] | None, ssim_weight: float
) -> Float[Tensor, ""]:
    """The scalar to minimise.

    image: the render, not clamped; the only input that gets a gradient. weight: w, from 0 (ignored) to 1, or None for 1
    everywhere. ssim_weight: s in [0, 1]. An image that is not finite in a valid pixel gives a loss that is not finite.
    """
    if image.dtype == torch.float32 and image.device.type == "cpu":
        from core.training.losses.photometric_cpu import photometric_cpu  # Numba takes half a second to load

        return photometric_cpu(image, target, weight, ssim_weight)
    if image.dtype == torch.float32 and image.device.type == "cuda":
        from core.training.losses.photometric_cuda import photometric_cuda  # Triton, which is there with a GPU only

        return photometric_cuda(image, target, weight, ssim_weight)
    return plain_photometric(image, target, weight, ssim_weight)


def plain_photometric(
    image: Float[Tensor, "h w 3"], target: Target, weight: Float[Tensor, "h w"] | None, ssim_weight: float
) -> Float[Tensor, ""]:
    """`photometric` in plain torch: what the kernel has to equal."""
    planes = planes_of(image, target.valid)
    error = _error(planes, target.planes, target.mean, target.mean_square, ssim_weight)
    if target.valid is not None:
        error = torch.where(target.valid, error, 0)
    weighted = error if weight is None else error * weight.detach()
    return weighted.sum() / target.valid_pixels


def photometric_paper(
    image: Float[Tensor, "h w 3"], target: Target, mask: Float[Tensor, "h w"], ssim_weight: float
) -> Float[Tensor, ""]:
    """`photometric` as the paper writes it (eq. 20): both pictures are multiplied by the mask before L1 and SSIM.

    The loss is the plain mean over valid pixels; masked areas match trivially, which rewards a mask of zero.
    """
    mask = mask.detach()
    return photometric(image * mask[..., None], target.masked(mask), None, ssim_weight)


def photometric_of_mask(
    image: Float[Tensor, "h w 3"], target: Target, mask: Float[Tensor, "h w"], ssim_weight: float
) -> Float[Tensor, ""]:
    """`photometric_paper` as the mask sees it: the gradient goes into the mask, and none into the image."""
    return plain_photometric(image.detach() * mask[..., None], target.masked(mask), None, ssim_weight)


def planes_of(picture: Tensor, valid: Tensor | None) -> Tensor:
    """(H, W, C) -> contiguous (C, H, W), zero where invalid (also where an invalid pixel is not finite)."""
    planes = picture.permute(2, 0, 1).contiguous()
    return planes if valid is None else torch.where(valid, planes, 0)


def _error(x: Tensor, y: Tensor, y_mean: Tensor, y_mean_square: Tensor, ssim_weight: float) -> Tensor:
    """(1 - s) |x - y| + s (1 - SSIM), averaged over the channels: (H, W)."""
    x_mean = blur(x)
    x_variance = blur(x * x) - x_mean**2
    y_variance = y_mean_square - y_mean**2
    covariance = blur(x * y) - x_mean * y_mean
    similarity = (2 * x_mean * y_mean + C1) * (2 * covariance + C2)
    similarity = similarity / ((x_mean**2 + y_mean**2 + C1) * (x_variance + y_variance + C2))
    return ((1 - ssim_weight) * (x - y).abs() + ssim_weight * (1 - similarity)).mean(dim=0)
