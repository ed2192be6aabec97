"""What a material says about a point of a surface, and how its texture coordinates lie."""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np


@dataclass
class Surface:
    """albedo: (3, N) linear reflectance. tilt: (3, N) added to the local normal before it is normalised, or None.
    emission: (3, N) radiance by night, or None. gloss: share of the mirrored sky, at grazing angles more.
    """

    albedo: np.ndarray
    tilt: np.ndarray | None = None
    emission: np.ndarray | None = None
    gloss: float | np.ndarray = 0.0


def colour(*values: float) -> np.ndarray:
    """A colour as (3,) float32."""
    return np.array(values, np.float32)


def wall_coordinates(point: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(u along, v up, which axis faces out) in metres on the side of a box; on top and bottom u, v = x, y."""
    axis = np.abs(normal).argmax(axis=0)
    u = np.where(axis == 0, point[1], point[0])
    v = np.where(axis == 2, point[1], point[2])
    return u, v, axis


def wall_tilt(along: np.ndarray, up: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """A tilt from slopes along u and v of `wall_coordinates`."""
    zero = np.zeros_like(along)
    return np.stack(
        [
            np.where(axis == 0, zero, along),
            np.where(axis == 0, along, np.where(axis == 2, up, zero)),
            np.where(axis == 2, zero, up),
        ]
    )


def sample(picture: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A (H, W) float32 picture read at u, v in [0, 1] (v up), bilinearly."""
    height, width = picture.shape
    columns, rows = (u * width - 0.5).astype(np.float32), ((1 - v) * height - 0.5).astype(np.float32)
    pad = -columns.size % 256  # cv2.remap refuses a row of more than 32,767
    columns, rows = (np.pad(a, (0, pad)).reshape(-1, 256) for a in (columns, rows))
    read = cv2.remap(picture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return read.reshape(-1)[: u.size]


@cache
def engraved(lines: tuple[str, ...], shape: tuple[int, int], scale: float, thickness: int) -> np.ndarray:
    """Text as a picture in [0, 1], one line under the other, centred. shape: (height, width), px."""
    height, width = shape
    picture = np.zeros(shape, np.uint8)
    for number, line in enumerate(lines):
        (wide, tall), _ = cv2.getTextSize(line, cv2.FONT_HERSHEY_TRIPLEX, scale, thickness)
        baseline = int(height * (number + 0.5) / len(lines) + tall / 2)
        cv2.putText(
            picture, line, ((width - wide) // 2, baseline), cv2.FONT_HERSHEY_TRIPLEX, scale, 255, thickness, cv2.LINE_AA
        )
    return picture.astype(np.float32) / 255
