"""A lens as structure from motion states it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Lens:
    """One of COLMAP's camera models, as plain values; `core.data.photos.distortion` undistorts with it.

    model: COLMAP's name. width, height: the size (px) it is stated for. params: in COLMAP's order. orientation: EXIF's,
    if it is the lens of the pixels as stored; 1 if it is that of the picture as displayed.
    """

    model: str
    width: int
    height: int
    params: list[float]
    orientation: int = 1
