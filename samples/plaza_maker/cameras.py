"""Where the tourists stand, and what their cameras see of the empty square."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class View:
    """A pinhole camera with OpenCV axes: x_camera = world_to_camera @ (x_world - centre).

    The principal point is the middle of the picture; the centre of the top-left pixel is at (0.5, 0.5).
    """

    world_to_camera: np.ndarray
    centre: np.ndarray
    focal_px: float
    width: int
    height: int

    def rays(self, x: float = 0.5, y: float = 0.5) -> np.ndarray:
        """Unit world directions (3, H * W) through the point (x, y) in [0, 1] of every pixel."""
        row, column = np.mgrid[0 : self.height, 0 : self.width]
        local = np.stack(
            [
                (column.ravel() + x - self.width / 2) / self.focal_px,
                (row.ravel() + y - self.height / 2) / self.focal_px,
                np.ones(row.size),
            ]
        )
        directions = self.world_to_camera.T @ local
        return (directions / np.linalg.norm(directions, axis=0)).astype(np.float32)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World points (P, 3) to pixels (P, 2) and depths (P,)."""
        local = (points - self.centre) @ self.world_to_camera.T
        depth = np.where(np.abs(local[:, 2]) < 1e-9, 1e-9, local[:, 2])
        middle = np.array([self.width / 2, self.height / 2])
        return local[:, :2] / depth[:, None] * self.focal_px + middle, local[:, 2]

    @property
    def dip(self) -> float:
        """How far below the horizon the middle of the lower edge looks, radians."""
        return float(
            np.arcsin(np.clip(-self.world_to_camera[2, 2], -1, 1)) + np.arctan(self.height / 2 / self.focal_px)
        )

    def shrunk(self, factor: float) -> "View":
        """The same view with fewer pixels."""
        return View(
            self.world_to_camera,
            self.centre,
            self.focal_px / factor,
            round(self.width / factor),
            round(self.height / factor),
        )


def look_at(centre, target, focal_px: float, width: int, height: int, roll: float = 0.0) -> View:
    """A camera at `centre` that looks at `target`, rolled by `roll` degrees."""
    centre, target = np.asarray(centre, float), np.asarray(target, float)
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
    return View(
        np.stack([c * right + s * down, -s * right + c * down, forward]), centre, float(focal_px), width, height
    )


def draw_view(rng: np.random.Generator, azimuth: float) -> View:
    """A random view from about an azimuth (degrees; 0 = right in front, positive = from the right).

    Most are at eye level, some from balconies and drones; lenses are wide or long, pictures upright or across.
    """
    portrait = rng.random() < 0.3
    width, height = (240, 320) if portrait else (320, 240)
    distance = float(rng.choice([rng.uniform(23, 29), rng.uniform(29, 38), rng.uniform(38, 48)], p=[0.25, 0.45, 0.30]))
    turn = np.radians(azimuth + rng.normal(0, 3))
    place = np.array([-1.0, 8.0]) + distance * np.array([1.12 * np.sin(turn), -np.cos(turn)])
    tall = rng.choice([rng.uniform(1.5, 1.9), rng.uniform(3.0, 7.0), rng.uniform(9.0, 16.0)], p=[0.74, 0.15, 0.11])
    target = np.array([rng.normal(0.5, 3.0), rng.uniform(0, 9), rng.uniform(7.5, 11.5)])
    if tall > 3:
        target[2] = rng.uniform(7, 11)
    # Metres of the building across the long side, by distance.
    span = rng.uniform(30, 50) / np.linalg.norm(target[:2] - place)
    if rng.random() < 0.16:
        span *= rng.uniform(0.55, 0.75)  # a detail: dome, tower, portico
        details = [(0, 8, 19.0), (14.6, 5, 17.0), (0, -4, 8.0), (-13, 5, 6.0), (-5.5, -10, 6.0), (6.0, -8.0, 7.0)]
        target = np.array(details[rng.integers(6)]) + rng.normal(0, 0.8, 3)
    focal = float(np.clip(320 / span, 215, 640)) * rng.uniform(0.95, 1.05)
    return look_at([*place, tall], target, focal, width, height, rng.normal(0, 1.3))
