"""Casting many rays at many solids: first hits, and whether the light gets through."""

from dataclasses import dataclass

import numpy as np

from samples.plaza_maker.solids import MISS, Solid, first_hit


@dataclass(frozen=True)
class Group:
    """Solids that stand together (a person, a tree) inside one bounding sphere, so that rays skip them at once."""

    solids: tuple[Solid, ...]
    transient: bool
    centre: np.ndarray
    radius: float


def group(solids, transient: bool = False) -> Group:
    """Solids under one bounding sphere."""
    bounds = [solid.bound for solid in solids]
    low = np.min([centre - radius for centre, radius in bounds], axis=0)
    high = np.max([centre + radius for centre, radius in bounds], axis=0)
    middle = (low + high) / 2
    reach = max(float(np.linalg.norm(centre - middle)) + radius for centre, radius in bounds)
    return Group(tuple(solids), transient, middle, reach)


@dataclass(frozen=True)
class Hits:
    """First hits of N rays: distance (MISS = sky), number of the solid in `solids` (-1 = sky), its hole (-1 = none)."""

    distance: np.ndarray
    number: np.ndarray
    hole: np.ndarray


@dataclass(frozen=True)
class World:
    """The groups of one moment, and their solids in one list."""

    groups: tuple[Group, ...]

    @property
    def solids(self) -> list[Solid]:
        """Every solid; Hits.number counts in this order."""
        return [solid for one in self.groups for solid in one.solids]

    @property
    def transient(self) -> np.ndarray:
        """For each solid, whether it belongs to a passer-by. (S,) bool."""
        return np.array([one.transient for one in self.groups for _ in one.solids], bool)


def _near(centre, radius, origins, directions, reach):
    """Which rays pass a sphere within `reach` metres."""
    x, y, z = (np.float32(c) - o for c, o in zip(centre, origins))
    along = x * directions[0] + y * directions[1] + z * directions[2]
    apart = x * x + y * y + z * z - along * along
    return (apart < np.float32(radius * radius)) & (along > -radius) & (along < reach + radius)


def cast(world: World, origins: np.ndarray, directions: np.ndarray) -> Hits:
    """The first hit of every ray. origins: (3,) or (3, N), directions: (3, N) float32 of length 1."""
    count = directions.shape[1]
    origins = np.broadcast_to(origins.reshape(3, -1), directions.shape)
    best = np.full(count, MISS, np.float32)
    number, hole = np.full(count, -1, np.int32), np.full(count, -1, np.int16)
    index = 0
    for one in world.groups:
        chosen = np.flatnonzero(_near(one.centre, one.radius, origins, directions, best))
        if not chosen.size:
            index += len(one.solids)
            continue
        group_origins, group_directions = origins[:, chosen], directions[:, chosen]
        for solid in one.solids:
            centre, radius = solid.bound
            touched = np.flatnonzero(_near(centre, radius, group_origins, group_directions, best[chosen]))
            if touched.size:
                t, within = first_hit(solid, group_origins[:, touched], group_directions[:, touched])
                rows = chosen[touched]
                nearer = t < best[rows]
                rows = rows[nearer]
                best[rows], number[rows], hole[rows] = t[nearer], index, within[nearer]
            index += 1
    return Hits(best, number, hole)


def way_is_open(
    world: World, origins: np.ndarray, directions: np.ndarray, reach: np.ndarray | float = 400.0
) -> np.ndarray:
    """Whether nothing stands within `reach` metres along each ray, (N,) bool. directions: (3,) or (3, N)."""
    directions = np.broadcast_to(directions.reshape(3, -1), origins.shape)
    open_way = np.ones(origins.shape[1], bool)
    reach = np.broadcast_to(np.asarray(reach, np.float32), open_way.shape)
    for one in world.groups:
        chosen = np.flatnonzero(open_way & _near(one.centre, one.radius, origins, directions, reach))
        if not chosen.size:
            continue
        for solid in one.solids:
            if solid.params.get("lets_light_through"):
                continue
            centre, radius = solid.bound
            rows = chosen[open_way[chosen]]
            rows = rows[_near(centre, radius, origins[:, rows], directions[:, rows], reach[rows])]
            if rows.size:
                t, _ = first_hit(solid, origins[:, rows], directions[:, rows])
                open_way[rows[t < reach[rows]]] = False
    return open_way
