"""The pinhole camera."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from core.scene.frame import SceneFrame

LARGEST_SIDE_PX = 1 << 20  # of a picture
# Of focal lengths and principal points: kernels keep them in float32, and write beyond their arrays where one is
# infinite.
LARGEST_PX = 1e30


def can_be_drawn(width: int, height: int, lens: Sequence[float]) -> bool:
    """Whether a picture of these sides by a lens of these fx, fy, cx and cy, all px,
    is one that kernels can draw; NaN is not."""
    is_picture = 1 <= min(width, height) and max(width, height) <= LARGEST_SIDE_PX
    return is_picture and min(lens[:2]) > 0 and all(abs(value) < LARGEST_PX for value in lens)


@dataclass(frozen=True)
class Camera:
    """An undistorted pinhole camera with OpenCV axes (x right, y down, z forward).

    x_camera = world_to_camera @ (x_world - centre). Keeping the centre, not a translation, lets callers subtract
    before they rotate, which is what keeps float32 exact far from the origin.

    world_to_camera: (3, 3) float64 rotation. centre: (3,) float64.
    fx, fy, cx, cy: pixels, COLMAP's convention: the centre of the top-left pixel is at (0.5, 0.5).
    """

    world_to_camera: np.ndarray
    centre: np.ndarray
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @staticmethod
    def centred(world_to_camera: np.ndarray, centre: np.ndarray, focal_px: float, width: int, height: int) -> "Camera":
        """A camera with square pixels and its principal point in the middle."""
        return Camera(world_to_camera, centre, focal_px, focal_px, width / 2, height / 2, width, height)

    def numbers(self) -> list[float]:
        """All its fields as numbers, in a fixed order."""
        lens = [self.fx, self.fy, self.cx, self.cy, self.width, self.height]
        return [float(number) for number in (*lens, *self.world_to_camera.ravel(), *self.centre)]

    def mean_focal_length(self) -> float:
        """The mean of fx and fy, px; pycolmap's cameras have a method of this name too."""
        return (self.fx + self.fy) / 2

    def resized(self, width: int, height: int) -> "Camera":
        """The same view at another picture size (pixels); x and y scale independently."""
        x, y = width / self.width, height / self.height
        return replace(self, fx=self.fx * x, fy=self.fy * y, cx=self.cx * x, cy=self.cy * y, width=width, height=height)

    def shrunk(self, share: float) -> "Camera":
        """The same view at `share` of its size, but no larger than it is, and of a pixel at least."""
        share = min(1.0, share)
        return self.resized(max(1, round(self.width * share)), max(1, round(self.height * share)))

    def within(self, long_side_px: int) -> "Camera":
        """The same view with a longer side of at most this many pixels."""
        return self.shrunk(long_side_px / max(self.width, self.height))

    def cropped(self, left: int, top: int, width: int, height: int) -> "Camera":
        """The window of the picture that starts at (left, top); all in pixels."""
        return replace(self, cx=self.cx - left, cy=self.cy - top, width=width, height=height)

    def in_scene(self, frame: SceneFrame) -> "Camera":
        """The camera moved from world units into the scene frame."""
        return replace(self, centre=frame.to_scene(self.centre))

    def in_world(self, frame: SceneFrame) -> "Camera":
        """The camera moved from the scene frame back into world units."""
        return replace(self, centre=frame.to_world(self.centre))

    def shows(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which of the points (P, 3) lie before the camera and inside its picture, (P,) bool, and their depths (P,)."""
        pixels, depths = self.project(points)
        return (depths > 0) & (pixels >= 0).all(axis=1) & (pixels <= (self.width, self.height)).all(axis=1), depths

    def in_axes(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) in the axes of the camera, from its centre."""
        return (points - self.centre) @ self.world_to_camera.T

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (P, 3) -> pixel positions (P, 2) and depths (P,), float64. Depths <= 0 lie behind the camera."""
        local = self.in_axes(np.asarray(points, dtype=np.float64))
        depth = local[:, 2]
        safe = np.where(np.abs(depth) > 1e-12, depth, 1e-12)
        pixels = np.stack([self.fx * local[:, 0] / safe + self.cx, self.fy * local[:, 1] / safe + self.cy], axis=1)
        return pixels, depth
