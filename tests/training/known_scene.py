"""A collection whose looks are known: one cloud of coloured balls, photographed as each test wants it."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import torch

import core.rasterizer
from core.data.collection import Collection, Photo
from core.scene.frame import SceneFrame
from core.scene.harmonics import dc_of_colour
from core.scene.splats import Splats
from tests.small import ring_camera

WIDTH, HEIGHT = 160, 120
MATCHED_FROM = 0.3  # a photo matches the balls that reach this share of a pixel of it
APART = 0.08  # radians between cameras: 4.6 degrees
SIDE = 40  # px, of who stands in the way

# What a test may do to the picture (H, W, 3) of photo `index`; True in the mask (H, W) where it hides the scene.


def plain(index: int, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A photo as it is."""
    return picture, np.zeros(picture.shape[:2], bool)


def exposed(index: int, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """In an exposure (a third of a stop either way) and white balance of its own."""
    random = np.random.default_rng(100 + index)
    return picture * np.exp(0.23 * random.normal() + 0.05 * random.normal(size=3)), plain(index, picture)[1]


def lit(index: int, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lit from another side in each photo: half of it lies in shade."""
    x, y = np.meshgrid(np.linspace(-1, 1, WIDTH), np.linspace(-1, 1, HEIGHT))
    shade = 1 / (1 + np.exp(-8 * (np.cos(2.4 * index) * x + np.sin(2.4 * index) * y)))
    return picture * (0.4 + 0.6 * shade[..., None]), plain(index, picture)[1]


def crowded(index: int, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """With somebody in the way, elsewhere in each photo."""
    random = np.random.default_rng(200 + index)
    left, top = random.integers(20, WIDTH - 20 - SIDE), random.integers(10, HEIGHT - 10 - SIDE)
    hidden = plain(index, picture)[1]
    hidden[top : top + SIDE, left : left + SIDE] = True
    return np.where(hidden[..., None], random.uniform(0, 1, 3), picture), hidden


def known_collection(folder: Path, change: Callable = plain, photos: int = 24, noise: float = 2.0) -> Collection:
    """Photos written into `folder`, every sixth one a test photo. noise: of each pixel, 8-bit steps."""
    random = np.random.default_rng(7)
    splats, points, colours = balls(random)
    rasterizer = core.rasterizer.create("cpu")
    made = []
    for index in range(photos):
        camera = ring_camera(APART * index).resized(WIDTH, HEIGHT)
        picture = rasterizer.render(splats, camera, background=(0.3, 0.5, 0.7)).numpy().astype(np.float64)
        picture, hidden = change(index, picture)
        pixels = (picture * 255 + random.normal(0, noise, picture.shape)).round().clip(0, 255).astype(np.uint8)
        path = folder / f"photo_{index:02d}.png"
        cv2.imwrite(str(path), pixels[..., ::-1])
        column, row = np.clip(camera.project(points)[0].astype(int), 0, [WIDTH - 1, HEIGHT - 1]).T
        matched = (rasterizer.contributions(splats, camera).numpy() >= MATCHED_FROM) & ~hidden[row, column]
        made.append(Photo(path.name, path, camera, "test" if index % 6 == 3 else "train", np.flatnonzero(matched)))
    return Collection("known", folder, "test", tuple(made), points, colours, SceneFrame(np.zeros(3), 1.0))


def balls(random: np.random.Generator, count: int = 900) -> tuple[Splats, np.ndarray, np.ndarray]:
    """Opaque balls in a sphere of radius 0.8, their centres and colours; near ones look alike, as on a wall."""
    points = random.normal(size=(count, 3))
    points *= 0.8 * random.uniform(size=(count, 1)) ** (1 / 3) / np.linalg.norm(points, axis=1, keepdims=True)
    colours = (0.5 + 0.25 * np.sin(1.5 * points @ random.normal(size=(3, 3)) + np.arange(3))).astype(np.float32)
    quaternions = torch.zeros(count, 4)
    quaternions[:, 0] = 1
    splats = Splats(
        means=torch.tensor(points, dtype=torch.float32),
        quaternions=quaternions,
        log_scales=torch.full((count, 3), 0.05).log(),
        logit_opacities=torch.logit(torch.full((count,), 0.95)),
        sh=dc_of_colour(torch.tensor(colours))[:, None],
    )
    return splats, points, colours
