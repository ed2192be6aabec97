"""A synthetic collection: a tower and a ball on a square, photographed in several lights, with passers-by.

It is for figures that anyone can reproduce without photos. The photos are rendered from known Gaussians, so the
scene is easier than a real one; its figures compare choices, not methods.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch

import core.rasterizer
from core.data.collection import Collection, Photo
from core.export.pictures import to_8_bit, write_png
from core.scene.camera import Camera
from core.scene.frame import SceneFrame
from core.scene.harmonics import coefficient_count, dc_of_colour
from core.scene.quaternions import from_z_onto
from core.scene.splats import Splats

WIDTH, HEIGHT, FOCAL = 112, 84, 105.0  # px
RENDERED_PX = 168, 126
PHOTOS, HELD_OUT_EVERY = 28, 4
SPACING = 0.055  # between two Gaussians of a surface, scene units
SHINE = 0.04  # of the bands above DC: surfaces look a little different from every side
POINTS_SHARE = 0.5  # of the Gaussians that "structure from motion" found
POINT_ERROR = 0.01  # scene units
PASSERS_BY_SHARE = 0.3  # of the training photos
AXES = (0.6, 0.6, 0.12)  # of a Gaussian, in spacings: along the surface twice, across it


@dataclass(frozen=True)
class Light:
    """sun: direction to it. colours in [0, 1], linear in the photo's values."""

    sun: np.ndarray
    sun_colour: np.ndarray
    ambient: np.ndarray
    sky: np.ndarray


@dataclass(frozen=True)
class Surface:
    """N Gaussians on surfaces. means, normals, albedo: (N, 3)."""

    means: np.ndarray
    normals: np.ndarray
    albedo: np.ndarray


def collection(folder: Path) -> Collection:
    """The photos, written into `folder`, their cameras, and rough SfM points.
    Every HELD_OUT_EVERY-th is a test photo."""
    random = np.random.default_rng(0)
    surface = square(random)
    rasterizer = core.rasterizer.create("auto")
    photos = []
    for index in range(PHOTOS):
        camera = camera_at(2 * np.pi * (index * 0.381966), 2.1 + 0.4 * random.random(), 0.5 + 0.5 * random.random())
        light = draw_light(random)
        splats = in_light(surface, light, degree=1)
        pixels = to_8_bit(rasterizer.render(splats, camera, background=tuple(light.sky.tolist())))
        split = "test" if index % HELD_OUT_EVERY == HELD_OUT_EVERY - 1 else "train"
        if split == "train" and random.random() < PASSERS_BY_SHARE:
            pixels = with_passer_by(pixels, random)
        path = folder / f"photo_{index:02d}.png"
        write_png(path, pixels)
        photos.append(Photo(path.name, path, camera, split))
    found = random.random(len(surface.means)) < POINTS_SHARE
    points = surface.means[found] + POINT_ERROR * random.normal(size=(int(found.sum()), 3))
    colours = (0.7 * surface.albedo[found]).astype(np.float32)
    frame = SceneFrame(np.zeros(3), 1.0)
    return Collection(
        name="built-in",
        root=folder,
        kind="built-in",
        photos=tuple(photos),
        points=points,
        point_colours=colours,
        frame=frame,
    )


def rendering_scene() -> tuple[Splats, list[Camera]]:
    """The Gaussians at noon with SH of degree 3, and two cameras: what the rendering figure always measures."""
    random = np.random.default_rng(0)
    noon = Light(np.array([0.4, 0.8, -0.45]), np.full(3, 0.7), np.full(3, 0.3), np.zeros(3))
    splats = in_light(square(random), noon, degree=3)
    # All opacities, because thresholds and early stops matter for haze.
    opacities = torch.from_numpy(random.uniform(0.05, 0.95, len(splats))).float()
    splats = replace(splats, logit_opacities=torch.logit(opacities))
    return splats, [camera_at(angle, 2.3, 0.8).resized(*RENDERED_PX) for angle in (0.3, 2.0)]


def square(random: np.random.Generator) -> Surface:
    """A paved disc, a tower of four sides and a ball, patterned."""
    lattice = np.arange(-1.0, 1.0, SPACING)
    x, z = (axis.ravel() for axis in np.meshgrid(lattice, lattice))
    inside = x**2 + z**2 < 1
    ground = np.stack([x[inside], np.zeros(inside.sum()), z[inside]], axis=1)
    parts = [(ground, np.tile([0.0, 1.0, 0.0], (len(ground), 1)), tiles(ground[:, 0], ground[:, 2], 0.25))]
    along, height = (axis.ravel() for axis in np.meshgrid(np.arange(-0.25, 0.25, SPACING), np.arange(0, 0.9, SPACING)))
    for turn in range(4):
        cosine, sine = np.cos(turn * np.pi / 2).round(), np.sin(turn * np.pi / 2).round()
        normal = np.array([sine, 0.0, cosine])
        wall = 0.25 * normal + np.stack([along * cosine, height, -along * sine], axis=1)
        parts.append((wall, np.tile(normal, (len(wall), 1)), tiles(along + 0.07 * turn, height, 0.15)[:, ::-1]))
    number = np.arange(300) + 0.5
    polar, azimuth = np.arccos(1 - 2 * number / 300), np.pi * (1 + 5**0.5) * number
    ball = np.stack([np.cos(azimuth) * np.sin(polar), np.cos(polar), np.sin(azimuth) * np.sin(polar)], axis=1)
    parts.append((0.22 * ball + [0.6, 0.22, 0.2], ball, tiles(azimuth % 1.0, polar, 0.4)))
    means, normals, albedo = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return Surface(means, normals, (albedo + 0.05 * random.normal(size=albedo.shape)).clip(0.02, 0.98))


def tiles(u: np.ndarray, v: np.ndarray, side: float) -> np.ndarray:
    """A chequered colour (N, 3) whose hue drifts across the surface."""
    dark = (np.floor(u / side) + np.floor(v / side)) % 2
    hue = np.stack(
        [0.55 + 0.2 * np.sin(3 * u), 0.5 + 0.15 * np.sin(2 * v + 1), 0.42 + 0.15 * np.cos(2 * u + v)], axis=1
    )
    return hue * (1 - 0.55 * dark)[:, None]


def in_light(surface: Surface, light: Light, degree: int) -> Splats:
    """The Gaussians lit by a sun without shadows (Lambert) and an ambient colour; opaque."""
    sun = light.sun / np.linalg.norm(light.sun)
    shade = np.clip(surface.normals @ sun, 0, None)[:, None]
    seen = torch.from_numpy(surface.albedo * (light.ambient + shade * light.sun_colour)).float()
    count = len(seen)
    random = np.random.default_rng(0)  # of the surface, not of the light
    sh = torch.from_numpy(SHINE * random.normal(size=(count, coefficient_count(degree), 3))).float()
    sh[:, 0] = dc_of_colour(seen)
    quaternions = from_z_onto(torch.from_numpy(surface.normals))  # the third axis is the thin one
    log_scales = torch.log(SPACING * torch.tensor(AXES)).expand(count, 3).contiguous()
    opacities = torch.full((count,), 3.0)
    return Splats(torch.from_numpy(surface.means).float(), quaternions, log_scales, opacities, sh)


def draw_light(random: np.random.Generator) -> Light:
    """Noon, evening or a grey day, each a little different every time."""
    kinds = {
        "noon": ([0.3, 0.9, 0.3], [0.75, 0.72, 0.66], [0.28, 0.31, 0.36], [0.45, 0.62, 0.9]),
        "evening": ([0.9, 0.3, -0.3], [0.85, 0.48, 0.25], [0.17, 0.16, 0.24], [0.85, 0.55, 0.4]),
        "grey": ([0.0, 1.0, 0.0], [0.1, 0.1, 0.1], [0.5, 0.52, 0.55], [0.7, 0.72, 0.75]),
    }
    sun, *usual = kinds[list(kinds)[random.integers(len(kinds))]]
    exposure = np.exp(0.15 * random.normal())
    colours = [np.clip(exposure * np.array(colour) * np.exp(0.05 * random.normal(size=3)), 0, 1) for colour in usual]
    return Light(np.array(sun) + 0.2 * random.normal(size=3), *colours)


def camera_at(angle: float, distance: float, height: float) -> Camera:
    """A camera at `angle` (radians) around the upright y axis that looks at the middle of the tower."""
    centre = np.array([distance * np.sin(angle), height, distance * np.cos(angle)])
    forward = np.array([0.0, 0.35, 0.0]) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Camera.centred(rotation, centre, FOCAL, WIDTH, HEIGHT)


def with_passer_by(pixels: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """The photo with somebody in a bright coat in its lower half."""
    foot = int(random.uniform(0.15, 0.85) * WIDTH), int(random.uniform(0.75, 0.95) * HEIGHT)
    tall = int(random.uniform(0.15, 0.3) * HEIGHT)
    coat = tuple(int(value) for value in random.integers(0, 256, size=3))
    drawn = pixels.copy()
    cv2.ellipse(drawn, (foot[0], foot[1] - tall // 2), (max(tall // 5, 1), tall // 2), 0, 0, 360, coat, -1, cv2.LINE_AA)
    cv2.circle(drawn, (foot[0], foot[1] - tall), max(tall // 7, 1), (214, 170, 140), -1, cv2.LINE_AA)
    return drawn
