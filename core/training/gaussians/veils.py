"""Veils: Gaussians that cover hardly anything of any photo, but much of the view from beside one.

Photos say little of the space close to other cameras. What floats there costs no loss, but blocks the view of anyone
who steps aside.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from core.rasterizer import Rasterizer
from core.rasterizer.importance import largest_shares
from core.report import OnProgress, ignore_progress
from core.scene.camera import Camera
from core.scene.splats import Splats

VIEWS_PER_PHOTO, MOST_VIEWS = 4, 400  # new views: for each photo, and in all
NEIGHBOURS, SAME_WAY = 3, 0.5  # how many cameras say how far one may step aside; the least cosine of their directions
LARGEST_STEP = 0.5  # of the distance to the nearest that a camera shows
NEAREST = 5  # percentile of the distances of points, for a few are wrong
# A step nearer makes a Gaussian cover this many times as much of a view at most; a veil, more.
MOST_BY_STEPPING = 1 / (1 - LARGEST_STEP) ** 2
LEAST_SHARE = 0.01  # of a new view, that a veil covers
SHRUNK = 1 / 4  # views are rendered at this share of their size


def veils(
    splats: Splats,
    cameras: Sequence[Camera],
    points: Float[np.ndarray, "p 3"],
    rasterizer: Rasterizer,
    on_progress: OnProgress = ignore_progress,
) -> Bool[Tensor, " n"]:
    """Which Gaussians are veils. cameras: of the photos; points: from SfM; all in the scene frame.
    on_progress: called after each view."""
    cameras = [camera.shrunk(SHRUNK) for camera in cameras]
    new = cameras_beside(cameras, points)
    views = len(cameras) + len(new)
    in_photos = largest_shares(splats, cameras, rasterizer, lambda done, _: on_progress(done, views))
    in_new_views = largest_shares(splats, new, rasterizer, lambda done, _: on_progress(len(cameras) + done, views))
    return (in_new_views > LEAST_SHARE) & (in_new_views > MOST_BY_STEPPING * in_photos)


def cameras_beside(cameras: Sequence[Camera], points: Float[np.ndarray, "p 3"]) -> list[Camera]:
    """New cameras, each up to a step away from one that took a photo and turned as it is;
    the same ones at each call."""
    generator = np.random.default_rng(0)
    rounds = [generator.permutation(len(cameras)) for _ in range(VIEWS_PER_PHOTO)]
    chosen = np.concatenate(rounds)[:MOST_VIEWS].tolist()
    steps = {number: _largest_step(cameras, number, points) for number in set(chosen)}
    beside = []
    for number in chosen:
        direction = generator.normal(size=3)
        # Evenly in a ball.
        aside = steps[number] * generator.random() ** (1 / 3) * direction / np.linalg.norm(direction)
        if steps[number]:
            beside.append(replace(cameras[number], centre=cameras[number].centre + aside))
    return beside


def _largest_step(cameras: Sequence[Camera], number: int, points: Float[np.ndarray, "p 3"]) -> float:
    """How far a new camera may be from this one: as far as others that look the same way;
    0 if none does, or it shows no points."""
    here, others = cameras[number], [*cameras[:number], *cameras[number + 1 :]]
    alike = [camera.centre for camera in others if camera.world_to_camera[2] @ here.world_to_camera[2] > SAME_WAY]
    shown, depths = here.shows(points)
    if not alike or not shown.any():
        return 0.0
    apart = np.sort(np.linalg.norm(np.array(alike) - here.centre, axis=1))
    return min(apart[:NEIGHBOURS].mean(), LARGEST_STEP * np.percentile(depths[shown], NEAREST))
