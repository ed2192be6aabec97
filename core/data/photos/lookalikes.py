"""Which photos are one picture, stored again in another size, format or quality, as collections from the web hold them."""

from math import log

import cv2
import numpy as np

SIDE = 32  # of the thumbnails that are compared
# How far two may differ, root mean square, as a part of the spread of their values. Photos of 500 px and more stored again at half their size or
# at JPEG quality 30 differ by 0.05 at most, moved sideways by 0.5% of their width by 0.1, and no two photos of Liberty, Sacré-Cœur, Fountain or
# Kermit by less than 0.2.
SAME = 0.06
ASPECT_TOLERANCE = 0.02


class Lookalikes:
    """Photos, one after the other, each compared with those before it."""

    def __init__(self):
        self._names: list[str] = []
        self._aspects: list[float] = []
        self._thumbnails: list[np.ndarray] = []

    def earlier(self, name: str, pixels: np.ndarray) -> str | None:
        """The name of the first photo that shows the same as this one, of (H, W, 3) uint8 as displayed, which is remembered if there is none."""
        height, width = pixels.shape[:2]
        aspect = log(width / height)
        thumbnail = cv2.resize(pixels, (SIDE, SIDE), interpolation=cv2.INTER_AREA).astype(np.float32).ravel()
        most = (SAME * thumbnail.std()) ** 2
        for other, its_aspect, its_thumbnail in zip(self._names, self._aspects, self._thumbnails, strict=True):
            if abs(aspect - its_aspect) <= ASPECT_TOLERANCE and np.square(thumbnail - its_thumbnail).mean() < most:
                return other
        self._names.append(name)
        self._aspects.append(aspect)
        self._thumbnails.append(thumbnail)
        return None
