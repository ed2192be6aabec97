"""The scenes that are measured: photos of samples/plaza, and a garden of any number of Gaussians from a fixed seed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from core.automatic import LEAST
from core.config import Settings
from core.data import load_collection
from core.data.collection import Collection
from core.scene.camera import Camera
from core.scene.splats import Splats

STEP_GAUSSIANS, STEP_SIZE_PX, STEP_PHOTOS = 30_000, (324, 210), 10
USUAL_SIZE_PX = (555, 360)  # as large as real photos are trained on a CPU, core.automatic.AUTO_PIXELS
GARDEN_GAUSSIANS, GARDEN_SIZE_PX = 140_000, (648, 420)
DEGREE, COEFFICIENTS = 3, 16  # of the garden and of what is baked; steps have the default degree
# The default settings for a scene that needs every part.
BAKED = Settings().decided(
    appearance="full", transients="on", sh_degree=DEGREE, sky="dome", transparency="unseen", **LEAST
)


def plaza(scale: float, size_px: tuple[int, int]) -> Collection:
    """The first wide photos of samples/plaza at another size, and points strewn around its SfM points.

    scale: of the number of points and of pixels. size_px: of the photos at scale 1.
    """
    sample = load_collection(Path(__file__).parents[1] / "plaza")
    size = [round(side * scale**0.5) for side in size_px]
    wide = [photo for photo in sample.split("train") if photo.camera.width > photo.camera.height][:STEP_PHOTOS]
    photos = tuple(replace(photo, camera=photo.camera.resized(*size)) for photo in wide)  # decoded to fit the camera
    random = np.random.default_rng(0)
    near = random.integers(len(sample.points), size=round(STEP_GAUSSIANS * scale))
    points = sample.points[near] + 0.015 * random.normal(size=(len(near), 3))  # about as far as they lie apart
    return replace(sample, photos=photos, points=points, point_colours=sample.point_colours[near])


def garden(count: int) -> Splats:
    """A table, a lawn and a hedge around them, z up: Gaussians in clumps, finer in the middle, most of them opaque."""
    random, clumps = np.random.default_rng(0), max(count // 100, 3)
    distance, angle = random.uniform(0, 3, clumps), random.uniform(0, 2 * np.pi, clumps)
    height = random.random(clumps) * np.select([distance < 0.4, distance > 2.6], [0.35, 1.5])
    centres = np.stack([distance * np.cos(angle), distance * np.sin(angle), height], axis=1)
    clump = random.integers(clumps, size=count)
    width = 0.02 + 0.05 * distance[clump, None]
    means = centres[clump] + width * random.normal(size=(count, 3)) * (1, 1, 0.5)
    log_scales = np.log(0.12 * width) + random.normal(size=(count, 3)) * (0.5, 0.5, 0.8)
    quaternions, sh = random.normal(size=(count, 4)), random.normal(size=(count, COEFFICIENTS, 3)) * 0.05
    parts = means, quaternions, log_scales, random.normal(1, 2, count), sh
    return Splats(*(torch.from_numpy(part).float() for part in parts))


def garden_camera(width: int, height: int) -> Camera:
    """Over the table, 16 degrees down."""
    axes = np.array([(1, 0, 0), (0, -0.28, -0.96), (0, 0.96, -0.28)])
    return Camera.centred(axes, np.array([0, -1.6, 0.8]), 1.1 * width, width, height)
