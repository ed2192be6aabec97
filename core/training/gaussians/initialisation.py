"""Where training starts: Gaussians at the SfM points, as in 3DGS, and the dome of the sky around them."""

import numpy as np
import torch
from scipy.spatial import cKDTree

from core.config import Settings
from core.data.collection import Collection, astray
from core.scene.harmonics import coefficient_count, dc_of_colour
from core.scene.quaternions import from_z_onto
from core.scene.splats import Splats
from core.training.gaussians.gaussians import Gaussians

INITIAL_OPACITY = 0.1  # 3DGS
LONE_SPACING = 0.1  # scene units: of a point without another
LEAST_SCALE = 1e-5  # scene units: of points that coincide
SKY_OPACITY = 0.99
SKY_MARGIN = 4.0  # the dome is at least this many times as far away as the farthest camera
SKY_FLATNESS = 0.01  # thickness of a dome Gaussian over its width


def most_points(settings: Settings) -> int:
    """How many SfM points at most become Gaussians: half of all that there may be, the other half is for growth."""
    return max(settings.max_gaussians // 2, 1)


def initial_gaussians(collection: Collection, settings: Settings, generator: torch.Generator) -> Gaussians:
    """Gaussians at the SfM points, as 3DGS starts, and the dome of the sky behind them."""
    points, colours = collection.points, collection.point_colours
    room = most_points(settings)
    if len(points) > room:
        chosen = np.sort(torch.randperm(len(points), generator=generator)[:room].numpy())
        points, colours = points[chosen], colours[chosen]
    # A lonely point must not start as haze over everything.
    scales = np.clip(spacings(points), LEAST_SCALE, settings.largest_scale / 2)
    parts = [_isotropic(points, scales, colours, INITIAL_OPACITY, settings.sh_degree)]
    sky_count = 0
    if settings.sky == "dome":
        parts.append(sky_dome(collection, settings))
        sky_count = len(parts[-1])
    parameters = Splats.concatenate(parts).tensors()
    if settings.latent_size and settings.appearance == "full":
        parameters["latents"] = torch.zeros(len(parameters["means"]), settings.latent_size)
    return Gaussians.of(parameters, sky_count)


def spacings(points: np.ndarray) -> np.ndarray:
    """(N,) root mean square distance of each point (N, 3) to the three nearest others, as 3DGS has it."""
    distances = cKDTree(points).query(points, k=range(1, min(4, len(points)) + 1))[0][:, 1:]
    return np.sqrt((distances**2).mean(axis=1)) if distances.size else np.full(len(points), LONE_SPACING)


def sky_dome(collection: Collection, settings: Settings) -> Splats:
    """Opaque discs on a sphere around scene and cameras: a sky that is made of Gaussians is in every exported file.

    Spread by the Fibonacci lattice. A disc is as wide as the lattice is spaced: so many overlap that on average less
    than 1e-3 of what is behind shines through.
    """
    count = settings.sky_gaussians
    # A dome too far off has holes, because rasterizers clamp the size of its discs (LOG_SCALE_RANGE). Hence the range
    # of sky_radius; and cameras that stand a million units off by mistake do not count.
    centres = np.stack([photo.camera.centre for photo in collection.photos])[~astray(collection.photos)]
    farthest = float(np.linalg.norm(centres, axis=1).max())
    radius = max(settings.sky_radius, SKY_MARGIN * farthest)
    index = np.arange(count) + 0.5
    height = 1.0 - 2.0 * index / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * index
    ring = np.sqrt(1.0 - height**2)
    normals = np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)
    width = radius * np.sqrt(4.0 * np.pi / count)
    colours = np.broadcast_to(collection.point_colours.mean(axis=0), normals.shape)
    dome = _isotropic(normals * radius, np.full(count, width), colours, SKY_OPACITY, settings.sh_degree)
    dome.quaternions = from_z_onto(torch.from_numpy(normals))
    dome.log_scales[:, 2] += float(np.log(SKY_FLATNESS))
    return dome


def _isotropic(means: np.ndarray, scales: np.ndarray, colours: np.ndarray, opacity: float, degree: int) -> Splats:
    """Spheres of one opacity, each with one scale and a colour that is the same from every side."""
    rows = len(means)
    sh = torch.zeros(rows, coefficient_count(degree), 3)
    sh[:, 0] = dc_of_colour(torch.from_numpy(np.array(colours, dtype=np.float32)))
    quaternions = torch.zeros(rows, 4)
    quaternions[:, 0] = 1
    return Splats(
        means=torch.from_numpy(means.astype(np.float32)),
        quaternions=quaternions,
        log_scales=torch.from_numpy(np.log(scales).astype(np.float32))[:, None].repeat(1, 3),
        logit_opacities=torch.logit(torch.full((rows,), opacity)),
        sh=sh,
    )
