"""Finds which way is down. COLMAP's models lie as their first photos were held;
in a viewer, one can walk around a scene that stands upright."""

import numpy as np
import pycolmap
from jaxtyping import Float

# How photos are held, in degrees: level, but tilted up at towers and down from them. With these, down is 0.2 degrees
# off on plaza, where it is known, and the two largest planes of Sacre-Coeur stand upright within 2 degrees (a tilt of
# 15 made that 9).
ROLL, TILT = 2.0, 30.0
ROUNDS = 20


def turn_upright(model: pycolmap.Reconstruction) -> None:
    """Turn a model with poses so that +y points down, as in a photo, and +z to where most photos look;
    origin and scale stay."""
    axes = np.array([image.cam_from_world().rotation.matrix() for image in model.images.values() if image.has_pose])
    down, ahead = find_down(axes), axes[:, 2].mean(axis=0)
    right = np.cross(down, ahead)
    if np.linalg.norm(right) < 1e-3:  # they look straight down, or all around
        right = np.cross(down, np.eye(3)[np.abs(down).argmin()])
    right /= np.linalg.norm(right)
    rotation = pycolmap.Rotation3d(np.array([right, down, np.cross(right, down)]))
    model.transform(pycolmap.Sim3d(1.0, rotation, np.zeros(3)))


def find_down(axes: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "3"]:
    """The unit vector that points down, from the rotations world to camera of photos (rows: right, below, ahead).

    Down is perpendicular to each photo's right axis, give or take ROLL, and to its viewing direction, give or take
    TILT: a fit by reweighted least squares, in which photos that disagree, such as those taken on edge, count little
    (Cauchy's loss). One fit starts from the mean of the axes that point below, another, for photos from above, from the
    mean viewing direction; the better one is taken.
    """
    right, below, ahead = axes.transpose(1, 0, 2)
    normals = np.concatenate([right / np.sin(np.radians(ROLL)), ahead / np.sin(np.radians(TILT))])

    def misfits(down: np.ndarray) -> np.ndarray:
        return ((normals @ down) ** 2).reshape(2, -1).sum(axis=0)

    fits = []
    for towards in (below.mean(axis=0), ahead.mean(axis=0)):
        down = towards / (np.linalg.norm(towards) or 1.0)
        for _ in range(ROUNDS):
            weights = np.tile(1 / (1 + misfits(down)), 2)
            down = np.linalg.eigh(normals.T @ (normals * weights[:, None]))[1][:, 0]
        fits.append(down)
    down = min(fits, key=lambda down: np.log1p(misfits(down)).sum())
    # From above, nothing is below but all is ahead.
    return down if (below + ahead / 2).sum(axis=0) @ down >= 0 else -down
