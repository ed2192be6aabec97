"""The radiance a camera sees: textures lit by sun, sky and lamps, with shadow rays for all of them."""

from dataclasses import dataclass

import numpy as np

from samples.plaza_maker.cameras import View
from samples.plaza_maker.looks import Look
from samples.plaza_maker.materials import MATERIALS
from samples.plaza_maker.rays import World, cast, way_is_open
from samples.plaza_maker.sky import ambient, sky
from samples.plaza_maker.solids import MISS, normals
from samples.plaza_maker.square import lamps
from samples.plaza_maker.surface import colour

SKY_RAYS = 6  # a sub-sample's share of the sky: with 2 x 2 of them a pixel sees 24 directions


@dataclass(frozen=True)
class Picture:
    """What a camera records. radiance: (H, W, 3), linear. transient: (H, W), the share of the pixel that passers-by
    cover. depth: (H, W), of one sub-sample near the pixel's middle (metres along the axis; inf: sky).
    """

    radiance: np.ndarray
    transient: np.ndarray
    depth: np.ndarray


def _spread(count: int, turn: float) -> np.ndarray:
    """(3, count) directions spread evenly over the upper hemisphere (golden-angle spiral)."""
    z = (np.arange(count) + 0.5) / count
    angle = np.arange(count) * 2.399963 + turn
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z]).astype(np.float32)


@dataclass(frozen=True)
class _Surfaces:
    """What N rays hit. albedo, emission: (3, N). normal: (3, N), with the relief of the material;
    flat: without. gloss: (N,)."""

    albedo: np.ndarray
    normal: np.ndarray
    flat: np.ndarray
    emission: np.ndarray
    gloss: np.ndarray


def _surfaces(world, look, origin, directions, hits, spread) -> _Surfaces:
    """The surfaces at all hits, computed solid by solid. spread: how much wider a ray gets per metre."""
    count = directions.shape[1]
    albedo, normal = np.zeros((3, count), np.float32), np.zeros((3, count), np.float32)
    flat = np.zeros((3, count), np.float32)
    emission, gloss = np.zeros((3, count), np.float32), np.zeros(count, np.float32)
    order = np.argsort(hits.number, kind="stable")
    order = order[hits.number[order] >= 0]
    solids = world.solids
    numbers, starts = np.unique(hits.number[order], return_index=True)
    for number, rows in zip(numbers, np.split(order, starts[1:])):
        solid = solids[number]
        points = origin[:, None] + directions[:, rows] * hits.distance[rows]
        local = solid.to_local(points)
        local_normal = normals(solid, local)
        for hole in np.unique(hits.hole[rows]):
            if hole >= 0:
                inner, within = solid.holes[hole], hits.hole[rows] == hole
                turned = solid.rotation @ inner.rotation.T @ -normals(inner, inner.to_local(points[:, within]))
                local_normal[:, within] = turned
        facing = np.abs((solid.rotation @ directions[:, rows] * local_normal).sum(0))
        footprint = (hits.distance[rows] * spread / np.sqrt(np.maximum(facing, 0.05))).astype(np.float32)
        surface = MATERIALS[solid.material](local, local_normal, footprint, solid.params)
        flat[:, rows] = solid.rotation.T @ local_normal
        if surface.tilt is not None:
            local_normal = local_normal + surface.tilt
            local_normal = local_normal / np.linalg.norm(local_normal, axis=0)
        albedo[:, rows] = surface.albedo
        normal[:, rows] = solid.rotation.T @ local_normal
        gloss[rows] = surface.gloss
        if surface.emission is not None:
            emission[:, rows] = surface.emission * look.lamps
    return _Surfaces(*(values[..., hits.number >= 0] for values in (albedo, normal, flat, emission, gloss)))


def _irradiance(world, look, points, normal, turn, turns):
    """The radiance that white walls would have at N points, (3, N):
    of sun, sky, the ground's reflection and lamps, with shadow rays.

    Each of the `turns` sub-samples looks at another point of the sun's disc and at other directions of the sky.
    """
    total = np.zeros_like(points)
    jitter = (
        np.array([np.cos(turn * 2.4), np.sin(turn * 2.4), np.sin(turn * 5.1)])
        * look.sun_width
        * np.sqrt((turn + 0.5) / turns)
    )
    toward = np.asarray(look.sun_direction) + jitter
    toward = (toward / np.linalg.norm(toward)).astype(np.float32)
    if max(look.sun) > 0 and toward[2] > 0:
        slant = normal.T @ toward
        rows = np.flatnonzero(slant > 0)
        open_way = way_is_open(world, points[:, rows], toward)
        total[:, rows] += colour(*look.sun)[:, None] * (slant[rows] * open_way)
    directions = _spread(SKY_RAYS, 1.7 * turn)
    light = ambient(look, directions)
    for number in range(SKY_RAYS):
        slant = normal.T @ directions[:, number]
        rows = np.flatnonzero(slant > 0)
        open_way = way_is_open(world, points[:, rows], directions[:, number], 30.0)
        total[:, rows] += light[:, number, None] * (2 / SKY_RAYS * slant[rows] * (0.15 + 0.85 * open_way))
    ground = 0.25 * (colour(*look.sun) * max(toward[2], 0) + light.mean(axis=1))
    total += ground[:, None] * (0.5 - 0.5 * normal[2]) * np.float32(0.9)
    if look.lamps > 0:
        for lamp in lamps():
            offset = lamp.place[:, None].astype(np.float32) - points
            distance = np.linalg.norm(offset, axis=0)
            direction = offset / np.maximum(distance, 1e-3)
            slant = (normal * direction).sum(0)
            rows = np.flatnonzero((slant > 0) & (distance < lamp.reach))
            open_way = way_is_open(world, points[:, rows], direction[:, rows], distance[rows] - 0.35)
            fall = (1 - (distance[rows] / lamp.reach) ** 2) ** 2 / (0.4 + distance[rows] ** 2)
            total[:, rows] += (lamp.power.astype(np.float32) * look.lamps)[:, None] * (slant[rows] * open_way * fall)
    return total


def _radiance(world, look, rays, distance, points, surfaces, turn, turns) -> np.ndarray:
    """What N rays (3, N) bring from the surfaces that they hit, (3, N):
    their own light, the sky mirrored in them, and the haze before them."""
    radiance = surfaces.albedo * _irradiance(world, look, points, surfaces.normal, turn, turns) + surfaces.emission
    shiny = np.flatnonzero(surfaces.gloss > 0)
    normal = surfaces.normal[:, shiny]
    slant = (rays[:, shiny] * normal).sum(0)
    mirrored = rays[:, shiny] - 2 * slant * normal
    grazing = (1 - np.clip(-slant, 0, 1)) ** 4
    share = np.clip(surfaces.gloss[shiny] * (0.35 + 1.5 * grazing), 0, 0.85)
    radiance[:, shiny] = radiance[:, shiny] * (1 - share) + ambient(look, mirrored) * share
    fog = 1 - np.exp(-look.haze * np.maximum(distance - 12, 0))
    low = rays.copy()
    low[2] = np.abs(low[2]) * 0.3
    return radiance * (1 - fog) + ambient(look, low) * fog


def render(world: World, look: Look, view: View, grid: int) -> Picture:
    """The picture of a world that a camera takes, with grid x grid samples per pixel."""
    samples = grid * grid
    radiance = np.zeros((view.height * view.width, 3), np.float32)
    transient, depth = (np.zeros(view.height * view.width, np.float32) for _ in range(2))
    for turn in range(samples):
        directions = view.rays((turn % grid + 0.5) / grid, (turn // grid + 0.5) / grid)
        origin = view.centre.astype(np.float32)
        hits = cast(world, origin, directions)
        seen = hits.number >= 0
        picture = np.zeros_like(directions)
        picture[:, ~seen] = sky(look, directions[:, ~seen])
        surfaces = _surfaces(world, look, origin, directions, hits, 0.8 / (view.focal_px * grid))
        rays, distance = directions[:, seen], hits.distance[seen]
        # Clear of the surface, so that it does not shade itself.
        points = origin[:, None] + rays * distance + surfaces.flat * np.float32(0.012)
        picture[:, seen] = _radiance(world, look, rays, distance, points, surfaces, turn, samples)
        radiance += np.minimum(picture.T, 8.0) / samples
        passing = np.zeros(seen.shape, bool)
        passing[seen] = world.transient[hits.number[seen]]
        transient += passing / np.float32(samples)
        if turn == samples // 2:
            along = view.world_to_camera[2].astype(np.float32) @ directions
            depth = np.where(hits.distance < MISS, hits.distance * along, np.inf)
    shape = (view.height, view.width)
    return Picture(radiance.reshape(*shape, 3), transient.reshape(shape), depth.reshape(shape))
