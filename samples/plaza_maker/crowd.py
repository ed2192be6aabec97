"""Putting passers-by in front of a camera until they cover the share of the photo that was asked for."""

import numpy as np

from samples.plaza_maker.cameras import View
from samples.plaza_maker.figures import bus, car, parasol, person
from samples.plaza_maker.rays import Group, World, cast
from samples.plaza_maker.square import FOUNTAIN, STATUE, standing_room

LARGEST = 0.14  # share of a photo that one passer-by or vehicle may cover
SHRINK = 4  # shares are counted in a picture this many times smaller


def _spot(rng: np.random.Generator) -> tuple[float, float, float]:
    """A random place (x, y, z; metres) where tourists like to stand:
    before and on the steps, round the fountain, at the statue."""
    kind = rng.choice(["front", "steps", "porch", "fountain", "statue"], p=[0.38, 0.14, 0.10, 0.25, 0.13])
    if kind == "front":
        return rng.uniform(-12, 12), rng.uniform(-14, -9.9), 0.0
    if kind == "steps":
        step = int(rng.integers(0, 5))
        return rng.uniform(-10, 10), -7.65 - 0.45 * (4 - step) + rng.uniform(0.0, 0.15), 0.18 * (step + 1)
    if kind == "porch":
        return rng.uniform(-7, 7), rng.uniform(-7.2, -6.7), 0.9
    middle, radius = (FOUNTAIN, rng.uniform(4.7, 7)) if kind == "fountain" else (STATUE, rng.uniform(2.7, 4.5))
    angle = rng.uniform(0, 2 * np.pi)
    return middle[0] + radius * np.cos(angle), middle[1] + radius * np.sin(angle), 0.0


def _ahead(rng, view: View, near: float, far: float) -> tuple[float, float]:
    """A random place on the ground in the camera's field of view, between two distances in metres."""
    forward = view.world_to_camera[2, :2] / np.linalg.norm(view.world_to_camera[2, :2])
    side = np.array([forward[1], -forward[0]])
    distance = np.exp(rng.uniform(np.log(near), np.log(far)))
    across = rng.uniform(-0.58, 0.58) * view.width / view.focal_px
    place = view.centre[:2] + distance * (forward + across * side)
    return float(place[0]), float(place[1])


def _newcomer(rng: np.random.Generator, view: View, mood: str) -> Group | None:
    """A random person, vehicle or parasol, as befits the mood of the photo;
    None if there is no room where it would stand."""
    chance = rng.random()
    # From a raised camera the ground begins only where its lower edge meets it.
    nearest = max(1.9, (view.centre[2] - 1.5) / max(np.tan(view.dip), 0.05))
    if mood == "traffic" and chance < 0.5:
        x, y = _ahead(rng, view, max(8.0, nearest), max(22.0, nearest * 1.8))
        heading = rng.uniform(0, 2 * np.pi)
        ends = [(x + t * np.cos(heading), y + t * np.sin(heading)) for t in (-5, -2.5, 0, 2.5, 5)]
        if not all(standing_room(*end) for end in ends) or np.hypot(x - view.centre[0], y - view.centre[1]) < 7:
            return None
        kind = rng.random()
        return car(rng, x, y, heading) if kind < 0.5 else bus(rng, x, y, heading, van=kind < 0.75)
    if mood == "close" and chance < 0.5:
        x, y = _ahead(rng, view, nearest, max(4.5, nearest * 1.6))
    elif chance < 0.55:
        x, y, z = _spot(rng)
        return person(rng, x, y, z)
    else:
        x, y = _ahead(rng, view, max(4.0, nearest), max(26.0, nearest * 2))
    if not standing_room(x, y):
        return None
    return parasol(rng, x, y) if mood == "market" and chance > 0.75 else person(rng, x, y)


def populate(rng: np.random.Generator, static: World, view: View, share: float) -> tuple[Group, ...]:
    """Passers-by who together cover about `share` of the photo, as far as the view shows any ground to stand on."""
    if share <= 0:
        return ()
    small = view.shrunk(SHRINK)
    directions, origin = small.rays(), small.centre.astype(np.float32)
    depth = cast(static, origin, directions).distance
    covered = np.zeros(depth.shape, bool)
    mood = str(rng.choice(["crowd", "close", "traffic", "market"], p=[0.35, 0.30, 0.22, 0.13]))
    people: list[Group] = []
    for _ in range(220):
        newcomer = _newcomer(rng, view, mood)
        if newcomer is None:
            continue
        hits = cast(World((newcomer,)), origin, directions)
        mine = (hits.number >= 0) & (hits.distance < depth)
        if (
            not 0 < mine.mean() < LARGEST
            or hits.distance.min() < 1.2
            or (covered | mine).mean() > min(share + 0.04, 0.26)
        ):
            continue
        people.append(newcomer)
        covered |= mine
        depth = np.where(mine, hits.distance, depth)
        if covered.mean() >= share:
            break
    return tuple(people)
