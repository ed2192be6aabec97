"""How close a render is to a photo: PSNR, SSIM, and the overlap of masks."""

import math

import cv2
import numpy as np
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from core.export.pictures import levels

WINDOW = 11  # px
SIGMA = 1.5  # px
C1 = 0.01**2
C2 = 0.03**2
# Mean squared: 100 dB, so that a single photo that is matched exactly does not make a mean infinite.
LEAST_ERROR = 1e-10
PSNR_KIND = "of the mean squared error over all scored pixels and R, G, B of a photo, dB, at most 100"
SSIM_KIND = "11 x 11 Gaussian window, sigma 1.5, whole windows only, mean over R, G, B"  # as in nerfbaselines


def quantised(picture: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
    """The picture as an 8-bit file would hold it, in [0, 1]. NaN stays NaN."""
    return levels(picture) / 255


def psnr(
    image: Float[Tensor, "h w 3"], photo: Float[Tensor, "h w 3"], valid: Bool[Tensor, "h w"] | None = None
) -> float:
    """-10 log10 of the mean squared error over the valid pixels (dB);
    at most 100, of equal pictures; NaN if none is valid."""
    squares = (image.double() - photo.double()) ** 2
    error = float(squares.mean() if valid is None else squares[valid].mean())
    return -10 * math.log10(max(error, LEAST_ERROR))


def ssim(
    image: Float[Tensor, "h w 3"], photo: Float[Tensor, "h w 3"], valid: Bool[Tensor, "h w"] | None = None
) -> float | None:
    """Structural similarity (Wang et al. 2004) for a range of 1, in float64; 1 for equal pictures.

    Only windows inside the picture that contain nothing but valid pixels count: there is no padding, as in
    nerfbaselines. The original 3DGS pads with zeros in both its metric and its loss; wegs only in its loss. None if no
    window fits, as in a picture of less than 11 pixels a side.
    """
    taps, rim = cv2.getGaussianKernel(WINDOW, SIGMA), WINDOW // 2
    whole = slice(rim, -rim), slice(rim, -rim)

    def blur(picture: np.ndarray) -> np.ndarray:
        return cv2.sepFilter2D(picture, cv2.CV_64F, taps, taps)[whole]

    x, y = (picture.detach().double().cpu().numpy() for picture in (image, photo))
    x_mean, y_mean = blur(x), blur(y)
    variances = blur(x * x) - x_mean**2 + blur(y * y) - y_mean**2
    covariance = blur(x * y) - x_mean * y_mean
    similarity = (2 * x_mean * y_mean + C1) * (2 * covariance + C2)
    similarity = similarity / ((x_mean**2 + y_mean**2 + C1) * (variances + C2))
    if valid is not None:
        similarity = similarity[cv2.erode(valid.cpu().numpy().astype(np.uint8), np.ones((WINDOW, WINDOW)))[whole] > 0]
    return float(similarity.mean()) if similarity.size else None


def mask_iou(mask: Float[Tensor, "h w"], static: Bool[Tensor, "H W"]) -> float:
    """Intersection over union of what is hidden (transient), in [0, 1]; 1 where neither hides anything.

    mask: predicted, 1 = static, of any size; enlarged to the truth's and hidden where < 0.5. static: the truth.
    """
    mask = F.interpolate(mask.detach()[None, None], size=static.shape, mode="bilinear", align_corners=False)[0, 0]
    hidden, truth = mask < 0.5, ~static
    union = int((hidden | truth).sum())
    return int((hidden & truth).sum()) / union if union else 1.0
