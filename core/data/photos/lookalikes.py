"""Whether two photo files hold the same picture in another size, format or quality,
as happens in collections from the web."""

from dataclasses import dataclass
from math import log
from typing import Self

import cv2
import numpy as np

SIDE, DETAIL_SIDE = 32, 128  # of the thumbnails that are compared: colours, and detail (brightness less its local mean)
SMOOTH = 9  # side of the square of which that is the mean
TILES = 8  # a side: the detail has to agree in each of them
FLAT = 3.0  # root mean square of a tile's detail, in 8-bit steps, below which the tile is ignored
# How far colours may differ (root mean square over their standard deviation), and how well detail has to correlate in
# every tile. Real photos stored again at half their size, or at JPEG quality 30, differ by 0.05 at most and correlate
# by 0.8 or more; two of Liberty, Sacré-Cœur, Fountain or Kermit differ by 0.2 or more and do not correlate. By detail
# alone, a place in two lights would be the same picture; by colours alone, a column seen from two sides.
SAME_COLOURS, SAME_DETAIL = 0.1, 0.75
# A side: if the mean colours of the blocks are already too far apart, the pixels need not be compared. Two of Liberty's
# 3,741 pairs get past so few blocks; more cost more than they spare, as each photo is compared with all before it.
BLOCKS = 2
ROUNDING = 1.001  # of sums in float32
ASPECT_TOLERANCE = 0.02


@dataclass(frozen=True)
class Thumbnail:
    """What is compared of a photo. aspect: log of width over height."""

    aspect: float
    colours: np.ndarray
    detail: np.ndarray

    @classmethod
    def of(cls, pixels: np.ndarray) -> Self:
        """pixels: (H, W, 3) uint8 RGB, as displayed."""
        height, width = pixels.shape[:2]
        colours = cv2.resize(pixels, (SIDE, SIDE), interpolation=cv2.INTER_AREA).astype(np.float32)
        small = cv2.resize(pixels, (DETAIL_SIDE, DETAIL_SIDE), interpolation=cv2.INTER_AREA)
        brightness = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY).astype(np.float32)
        return cls(log(width / height), colours.ravel(), brightness - cv2.blur(brightness, (SMOOTH, SMOOTH)))

    def shows_same(self, other: Self) -> bool:
        """Whether both are of the same picture."""
        if abs(self.aspect - other.aspect) > ASPECT_TOLERANCE:
            return False
        if np.square(self.colours - other.colours).mean() >= self.colours_slack():
            return False
        mine, its = self._tiles(), other._tiles()
        power, its_power = np.square(mine).mean(axis=1), np.square(its).mean(axis=1)
        shown = np.minimum(power, its_power) > FLAT**2
        correlations = (mine * its).mean(axis=1)[shown] / np.sqrt(power * its_power)[shown]
        return bool(shown.any() and correlations.min() > SAME_DETAIL)

    def colours_slack(self) -> float:
        """The mean square difference of colours from which on another thumbnail is of another picture."""
        return (SAME_COLOURS * self.colours.std()) ** 2

    def block_colours(self) -> np.ndarray:
        """(BLOCKS * BLOCKS * 3,) means of the colours."""
        side = SIDE // BLOCKS
        return self.colours.reshape(BLOCKS, side, BLOCKS, side, 3).mean(axis=(1, 3)).ravel()

    def _tiles(self) -> np.ndarray:
        side = DETAIL_SIDE // TILES
        return self.detail.reshape(TILES, side, TILES, side).swapaxes(1, 2).reshape(TILES * TILES, side * side)


class Pictures:
    """The pictures met so far, by name."""

    def __init__(self):
        self._met: list[tuple[str, Thumbnail]] = []
        self._blocks = np.empty((0, BLOCKS * BLOCKS * 3), np.float32)

    def meet(self, name: str, pixels: np.ndarray) -> str | None:
        """The name under which this picture was met before; None for a new one, which is remembered.
        pixels: as for `Thumbnail.of`."""
        thumbnail = Thumbnail.of(pixels)
        blocks = thumbnail.block_colours()
        near = np.square(self._blocks - blocks).mean(axis=1) < ROUNDING * thumbnail.colours_slack()
        for row in np.flatnonzero(near):
            before, met = self._met[row]
            if thumbnail.shows_same(met):
                return before
        self._met.append((name, thumbnail))
        self._blocks = np.vstack([self._blocks, blocks])
        return None
