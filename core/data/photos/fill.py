"""Fills the parts of a photo that are not used with the colours around them, so that nobody's clothes tint a look."""

import cv2
import numpy as np
from jaxtyping import Bool, UInt8


def fill(pixels: UInt8[np.ndarray, "h w 3"], use: Bool[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w 3"]:
    """The photo where `use` is True (bit for bit), and a smooth continuation of it elsewhere;
    `use` must be True somewhere.

    Pull-push (Gortler et al. 1996, The Lumigraph, section 3.4): known colours are averaged down to a single pixel, and
    holes are filled on the way back from the coarser level. Time is linear in the number of pixels, however large the
    holes.
    """
    weights: list[np.ndarray] = [use.astype(np.float32)]
    colours: list[np.ndarray] = [pixels * weights[0][..., None]]
    while max(weights[-1].shape) > 1:
        size = tuple((side + 1) // 2 for side in weights[-1].shape[::-1])
        weights.append(cv2.resize(weights[-1], size, interpolation=cv2.INTER_AREA))
        colours.append(cv2.resize(colours[-1], size, interpolation=cv2.INTER_AREA).reshape(*size[::-1], 3))
    filled = colours[-1] / weights[-1][..., None]
    for colour, weight in zip(colours[-2::-1], weights[-2::-1], strict=True):
        coarser = cv2.resize(filled, weight.shape[::-1], interpolation=cv2.INTER_LINEAR).reshape(colour.shape)
        filled = colour + (1 - weight[..., None]) * coarser  # `colour` is weighted already
    return np.where(use[..., None], pixels, np.rint(filled).clip(0, 255).astype(np.uint8))
