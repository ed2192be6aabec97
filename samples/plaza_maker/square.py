"""What stands round the landmark: ground, fountain with obelisk, statue, trees, lamps, houses, hills."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from samples.plaza_maker.church import TOWER, church
from samples.plaza_maker.masonry import GOLD
from samples.plaza_maker.rays import Group, group
from samples.plaza_maker.solids import limb, make
from samples.plaza_maker.surface import colour

FOUNTAIN = (-5.5, -17.0)
STATUE = (9.5, -14.5)
LAMPS = (
    (-13.0, -11.0),
    (13.0, -9.5),
    (-14.0, -24.0),
    (3.0, -24.5),
    (16.5, -21.0),
    (-24.0, -3.0),
    (24.0, -4.0),
    (20.0, 16.0),
)
TREES = (
    (-21.0, -8.0),
    (-24.5, -15.0),
    (-20.5, -22.5),
    (22.0, -11.5),
    (25.0, -18.0),
    (24.5, 6.0),
    (-28.0, 3.0),
    (27.5, 18.0),
    (-28.0, 16.0),
)
FLOODLIGHTS = (
    (-9.0, -8.6),
    (-3.0, -9.0),
    (3.0, -9.0),
    (9.0, -8.6),
    (12.4, -1.5),
    (18.8, -1.0),
    (-16.5, 0.5),
    (-12.6, 14.0),
    (18.6, 10.5),
)


@dataclass(frozen=True)
class Lamp:
    """A lamp that is lit by night. place: (3,) metres.
    power: (3,) radiance of a white wall at one metre. reach: metres."""

    place: np.ndarray
    power: np.ndarray
    reach: float


def fountain() -> list[Group]:
    """A ring basin, a bowl, and an obelisk with carved signs."""
    x, y = FOUNTAIN
    well = make("frustum", (x, y, 0.9), (3.0, 3.0, 0.6), "marble")
    basin = [
        make("frustum", (x, y, 0.12), (4.1, 4.1, 0.12), "marble"),
        make("frustum", (x, y, 0.5), (3.4, 3.4, 0.42), "marble", holes=[well], taper=0.96),
        make("frustum", (x, y, 0.35), (3.05, 3.05, 0.33), "water"),
        make("frustum", (x, y, 1.2), (0.95, 0.95, 0.9), "ashlar", block=(0.7, 0.3), taper=0.75),
        make("frustum", (x, y, 2.15), (0.75, 0.75, 0.3), "marble", taper=2.3),
        make("frustum", (x, y, 2.42), (1.6, 1.6, 0.06), "water"),
        make("box", (x, y, 3.0), (0.72, 0.72, 0.6), "marble"),
    ]
    for number in range(4):
        angle = np.pi / 4 + number * np.pi / 2
        c, s = np.cos(angle), np.sin(angle)
        bronze = {"material": "metal", "colour": (0.2, 0.3, 0.24)}
        basin.append(make("sphere", (x + 1.35 * c, y + 1.35 * s, 1.0), (0.42, 0.42, 0.5), **bronze))
        basin.append(limb((x + 1.6 * c, y + 1.6 * s, 1.35), (x + 1.85 * c, y + 1.85 * s, 0.9), 0.2, 0.1, **bronze))
    signs = ("A Y", "+ o", "V =", "N *", "T #", "o X", "= Z", "W +", "* H", "Y V")
    carving = {"lines": signs, "shape": (640, 96), "scale": 1.15, "thickness": 3, "ink": colour(0.16, 0.09, 0.07)}
    shaft = [
        make(
            "box",
            (x, y, 6.7),
            (0.46, 0.46, 3.1),
            "inscription",
            area=(-0.4, -3.0, 0.8, 6.0),
            tone=(1.0, 0.72, 0.62),
            **carving,
        ),
        make("frustum", (x, y, 10.15), (0.62, 0.62, 0.35), "metal", colour=GOLD, taper=0.05),
        make("sphere", (x, y, 10.75), (0.22, 0.22, 0.22), "metal", colour=GOLD),
    ]
    return [group(basin), group(shaft)]


def statue() -> list[Group]:
    """A bronze leader with a raised arm and a spear, on a pedestal with a dedication."""
    x, y = STATUE
    bronze = {"material": "metal", "colour": (0.13, 0.23, 0.18)}
    text = {
        "lines": ("FELIX", "PICTOR", "SOLIS", "MMXXV"),
        "shape": (256, 256),
        "scale": 1.5,
        "thickness": 3,
        "area": (-1.0, -0.9, 2.0, 1.8),
    }
    pedestal = [
        make("box", (x, y, 0.2), (2.1, 2.1, 0.2), "marble"),
        make("box", (x, y, 0.5), (1.7, 1.7, 0.15), "marble"),
        make("box", (x, y, 1.75), (1.15, 1.15, 1.15), "inscription", **text),
        make("box", (x, y, 3.0), (1.4, 1.4, 0.14), "marble", dentils=0.3),
    ]
    z = 3.14

    def part(start, end, first, second):
        return limb(np.array([x, y, z]) + start, np.array([x, y, z]) + end, first, second, **bronze)

    figure = [
        part((-0.24, 0, 0), (-0.2, 0, 1.3), 0.17, 0.24),
        part((0.3, -0.25, 0), (0.2, 0, 1.3), 0.17, 0.24),
        part((0, 0, 1.1), (0, 0, 2.3), 0.46, 0.5),
        make("sphere", (x, y, z + 2.35), (0.52, 0.32, 0.3), **bronze),
        make("sphere", (x, y - 0.04, z + 2.9), (0.21, 0.23, 0.29), **bronze),
        part((0.45, 0, 2.35), (0.95, -0.3, 2.85), 0.17, 0.13),
        part((0.95, -0.3, 2.85), (1.15, -0.5, 3.6), 0.13, 0.08),
        part((-0.45, 0, 2.35), (-0.8, -0.25, 1.7), 0.17, 0.13),
        part((-0.85, -0.4, 0), (-0.85, -0.4, 4.0), 0.05, 0.04),
        part((0, 0.3, 0.3), (0, 0.25, 2.4), 0.62, 0.34),
    ]
    return [group(pedestal), group(figure)]


def tree(x: float, y: float, seed: int) -> Group:
    """A trunk with boughs under some fifty clumps of leaves."""
    rng = np.random.default_rng(seed)
    height = rng.uniform(2.2, 3.0)
    crown = np.array([x, y, height + 2.4])
    leaf = np.array([0.15, 0.24, 0.06]) * rng.uniform(0.8, 1.25, 3)
    parts = [limb((x, y, 0), (x, y, height + 1.2), 0.3, 0.18, "bark")]
    for number in range(52):
        angle, rise = rng.uniform(0, 2 * np.pi), rng.uniform(-1, 1)
        reach = 2.25 * np.sqrt(max(0.05, 1 - rise * rise)) * rng.uniform(0.6, 1.0)
        place = crown + [reach * np.cos(angle), reach * np.sin(angle), 2.1 * rise]
        size = rng.uniform(0.38, 0.8) * np.array([1.0, 1.0, rng.uniform(0.65, 0.95)])
        parts.append(make("sphere", place, size, "foliage", offset=float(3.1 * number), leaf=tuple(leaf)))
        if number < 4:
            parts.append(limb((x, y, height), place, 0.14, 0.06, "bark"))
    return group(parts)


def lamp_post(x: float, y: float) -> Group:
    """A cast post with a globe on each arm."""
    parts = [
        make("frustum", (x, y, 0.3), (0.26, 0.26, 0.3), "metal", taper=0.6),
        limb((x, y, 0.4), (x, y, 4.4), 0.1, 0.06, "metal"),
        limb((x - 0.55, y, 4.2), (x + 0.55, y, 4.2), 0.04, 0.04, "metal"),
    ]
    for dx, dz in ((-0.55, 0.25), (0.55, 0.25), (0, 0.6)):
        parts.append(make("sphere", (x + dx, y, 4.2 + dz), (0.2, 0.2, 0.24), "lamp", lets_light_through=True))
    return group(parts)


def houses() -> list[Group]:
    """A ring of town houses with pitched roofs, and hills behind."""
    rng = np.random.default_rng(77)
    walls = [
        (0.62, 0.43, 0.24),
        (0.66, 0.55, 0.38),
        (0.55, 0.30, 0.20),
        (0.60, 0.56, 0.50),
        (0.64, 0.38, 0.28),
        (0.47, 0.45, 0.36),
    ]
    shutters = [(0.07, 0.16, 0.09), (0.18, 0.10, 0.06), (0.10, 0.14, 0.20), (0.28, 0.26, 0.22)]
    result, angle = [], 0.0
    while angle < 2 * np.pi - 0.08:
        half = rng.uniform(5.0, 9.0)
        turn = 2 * half / 66
        middle = angle + turn / 2
        distance = 66 + rng.uniform(-2, 5)
        x, y = distance * np.sin(middle), 6 + distance * np.cos(middle)
        tall = rng.uniform(3, 6.4) * 3.1 / 2
        params = {
            "seed": int(rng.integers(1, 10_000)),
            "colour": walls[rng.integers(len(walls))],
            "shutter": shutters[rng.integers(len(shutters))],
        }
        yaw = -np.degrees(middle)
        block = [make("box", (x, y, tall), (half, 5.0, tall), "house", yaw=yaw, **params)]
        block.append(make("prism", (x, y, 2 * tall), (5.6, half + 0.3, rng.uniform(1.6, 2.6)), "tiles", yaw=yaw + 90))
        result.append(group(block))
        angle += turn * rng.uniform(0.98, 1.06)
    for x, y, size, tall in (
        (-150, 230, 130, 42),
        (60, 300, 160, 34),
        (240, 180, 120, 46),
        (-290, 40, 130, 30),
        (300, -60, 120, 38),
    ):
        result.append(group([make("sphere", (x, y, -6), (size, size * 0.7, tall), "hill")]))
    return result


def furniture() -> list[Group]:
    """Benches and planters."""
    result = []
    for x, y, yaw in ((-12.5, -15.0, 80), (-1.5, -24.0, 5), (4.5, -11.5, -10), (15.5, -14.0, 95), (-12.0, -20.5, 100)):
        c, s = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
        parts = [make("box", (x, y, 0.46), (1.0, 0.25, 0.05), "bark", yaw=yaw)]
        parts += [make("box", (x + t * c, y + t * s, 0.2), (0.12, 0.22, 0.2), "marble", yaw=yaw) for t in (-0.75, 0.75)]
        result.append(group(parts))
    for x, y in ((-12.4, -8.6), (12.4, -6.5), (-15.2, 1.8), (-19.6, 1.8), (17.9, 0.4)):
        pot = [
            make("frustum", (x, y, 0.4), (0.42, 0.42, 0.4), "tiles", taper=1.35),
            make("sphere", (x, y, 1.25), (0.62, 0.62, 0.75), "foliage"),
        ]
        result.append(group(pot))
    return result


@cache
def static_groups() -> tuple[Group, ...]:
    """Everything that stays."""
    ground = make("box", (0, 0, -1.0), (700, 700, 1.0), "paving", fountain=FOUNTAIN)
    return (
        *church(),
        *fountain(),
        *statue(),
        *(tree(x, y, 300 + n) for n, (x, y) in enumerate(TREES)),
        *(lamp_post(x, y) for x, y in LAMPS),
        *furniture(),
        *houses(),
        group([ground]),
    )


def lamps() -> tuple[Lamp, ...]:
    """The lights of the night: posts, floodlights at the foot of the walls, lamps in portico, drum and belfry."""
    posts = [Lamp(np.array([x, y, 4.7]), np.array([1.0, 0.66, 0.32]) * 3.6, 15.0) for x, y in LAMPS]
    floods = [Lamp(np.array([x, y, 0.5]), np.array([1.0, 0.74, 0.42]) * 9.0, 24.0) for x, y in FLOODLIGHTS]
    inner = [Lamp(np.array([x, -3.0, 7.6]), np.array([1.0, 0.6, 0.25]) * 4.0, 12.0) for x in (-5.0, 0.0, 5.0)]
    crown = [
        Lamp(np.array([x, y, 14.2]), np.array([0.75, 0.85, 1.0]) * 6.0, 16.0)
        for x, y in ((-7.5, 5.0), (7.5, 5.0), (0.0, 3.0))
    ]
    belfry = [Lamp(np.array([*TOWER, 21.0]), np.array([1.0, 0.6, 0.25]) * 3.0, 8.0)]
    arcade = [Lamp(np.array([x, 6.0, 3.8]), np.array([1.0, 0.6, 0.25]) * 2.0, 10.0) for x in (-19.5, -14.5)]
    return (*posts, *floods, *inner, *crown, *belfry, *arcade)


def standing_room(x: float, y: float) -> bool:
    """Whether a passer-by can stand at (x, y) without being inside something."""
    if -12.9 < x < 12.9 and -9.7 < y < 29.5 or -23.4 < x < -9.5 and 2.2 < y < 14 or 11 < x < 18.4 and 1 < y < 9:
        return False
    if np.hypot(x - FOUNTAIN[0], y - FOUNTAIN[1]) < 4.6 or np.hypot(x - STATUE[0], y - STATUE[1]) < 2.6:
        return False
    return min(np.hypot(x - a, y - b) for a, b in LAMPS + TREES) > 1.0
