"""The landmark: a domed church with a portico, a bell tower and a loggia."""

import numpy as np

from samples.plaza_maker.masonry import GOLD, VERDIGRIS
from samples.plaza_maker.rays import Group, group
from samples.plaza_maker.solids import limb, make

PLATFORM = 0.9  # metres; the top of the steps
TOWER = (14.6, 5.0)


def _box(low, high, material, **params):
    """A box between two corners."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    return make("box", (low + high) / 2, (high - low) / 2, material, **params)


def _column(x, y, bottom, top, radius):
    """Base, fluted shaft with entasis, and capital."""
    shaft_low, shaft_high = bottom + 0.42, top - 0.62
    middle, half = (shaft_low + shaft_high) / 2, (shaft_high - shaft_low) / 2
    return [
        _box(
            (x - 1.35 * radius, y - 1.35 * radius, bottom),
            (x + 1.35 * radius, y + 1.35 * radius, bottom + 0.2),
            "marble",
        ),
        make("sphere", (x, y, bottom + 0.32), (1.3 * radius, 1.3 * radius, 0.16), "marble"),
        make("frustum", (x, y, middle), (radius, radius, half), "fluted", taper=0.84),
        make("frustum", (x, y, top - 0.42), (0.86 * radius, 0.86 * radius, 0.22), "marble", taper=1.45),
        _box((x - 1.3 * radius, y - 1.3 * radius, top - 0.2), (x + 1.3 * radius, y + 1.3 * radius, top), "marble"),
    ]


def _person_of_stone(x, y, z, size):
    """A standing robed figure for niches and pedestals."""

    def at(dx, dy, dz):
        return np.array([x + dx * size, y + dy * size, z + dz * size])

    return [
        limb(at(0, 0, 0), at(0, 0, 1.0), 0.27 * size, 0.17 * size, "marble"),
        make("sphere", at(0, 0, 1.18), np.array([0.24, 0.16, 0.3]) * size, "marble"),
        make("sphere", at(0, -0.02, 1.62), np.array([0.1, 0.11, 0.14]) * size, "marble"),
        limb(at(0.22, 0, 1.34), at(0.36, -0.16, 1.0), 0.07 * size, 0.05 * size, "marble"),
        limb(at(-0.22, 0, 1.34), at(-0.42, -0.16, 1.62), 0.07 * size, 0.05 * size, "marble"),
    ]


def steps() -> list[Group]:
    """The platform that everything stands on, and the five steps up to it."""
    treads = []
    for number in range(5):
        reach = 0.45 * (4 - number)
        treads.append(
            _box(
                (-10.6 - reach, -7.4 - reach, 0),
                (10.6 + reach, 27 + reach, 0.18 * (number + 1)),
                "ashlar",
                block=(2.0, 0.18),
                tone=(1.05, 1.05, 1.05),
            )
        )
    return [group(treads)]


def portico() -> list[Group]:
    """Eight columns, an entablature with an inscription, and a pediment with reliefs."""
    places = [(x, -5.6) for x in (-7.6, -4.55, -1.55, 1.55, 4.55, 7.6)] + [(-7.6, -2.6), (7.6, -2.6)]
    columns = [group(_column(x, y, PLATFORM, 8.5, 0.56)) for x, y in places]
    text = {
        "lines": ("LVX  MVTAT  LAPIDES  MANENT",),
        "shape": (72, 1024),
        "scale": 1.75,
        "thickness": 4,
        "area": (-7.3, -0.33, 14.6, 0.66),
    }
    entablature = [
        _box((-8.4, -6.4, 8.5), (8.4, 0, 9.05), "marble"),
        _box((-8.4, -6.4, 9.05), (8.4, 0, 9.85), "inscription", **text),
        _box((-8.75, -6.75, 9.85), (8.75, 0, 10.02), "marble", dentils=0.36, tone=(0.9, 0.9, 0.9)),
        _box((-9.05, -7.05, 10.02), (9.05, 0, 10.25), "marble"),
    ]
    pediment = [make("prism", (0, -3.2, 10.25), (8.5, 3.2, 3.0), "relief", triangle=(8.5, 3.2, 3.0))]
    for side in (-1, 1):  # raking cornices and the roof on them
        angle = np.arctan2(3.1, 9.0) * side
        c, s = np.cos(angle), np.sin(angle)
        lean = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        middle = np.array([side * 4.62, 0, 11.86])
        pediment.append(make("box", middle + [0, -3.55, 0], (4.95, 3.55, 0.16), "marble", rotation=lean))
        pediment.append(make("box", middle + [0, -3.4, 0.2], (4.9, 3.4, 0.07), "tiles", rotation=lean))
    acroteria = [
        part for x, z in ((-8.9, 10.25), (0, 13.45), (8.9, 10.25)) for part in _person_of_stone(x, -6.4, z, 1.15)
    ]
    return [*columns, group(entablature), group(pediment), group(acroteria)]


def nave() -> list[Group]:
    """The body: a limestone front with door and niches, flanks with tall windows between pilasters, tiled roofs."""
    door = make("arch", (0, 0, PLATFORM), (1.65, 0.9, 3.9), "marble")
    niches = [make("arch", (x, 0, 2.4), (0.8, 0.55, 2.3), "marble") for x in (-5.6, 5.6)]
    bays = [3.0, 7.5, 12.0, 16.5, 21.0]
    windows = [make("arch", (side * 10, y, 4.2), (0.95, 0.6, 3.3), "marble", yaw=90) for side in (-1, 1) for y in bays]
    centre, half = np.array([0, 13.0, 6.45]), np.array([10.0, 13.0, 5.55])
    body = [make("box", centre, half, "ashlar", holes=[door, *niches])]
    flanks = [
        make("box", (side * 9.9, 13.0, 6.45), (0.35, 12.95, 5.5), "brick", band=3.7, offset=1.0, holes=windows)
        for side in (-1, 1)
    ]
    panes = [
        _box((side * 10.0 - 0.12, y - 0.95, 4.2), (side * 10.0 + 0.12, y + 0.95, 8.5), "glass")
        for side in (-1, 1)
        for y in bays
    ]
    inside = [
        make("box", (0, 0.75, PLATFORM + 2.8), (1.7, 0.1, 2.8), "bronze_door"),
        *_person_of_stone(-5.6, 0.05, 2.45, 1.5),
        *_person_of_stone(5.6, 0.05, 2.45, 1.5),
    ]
    trims = [
        _box((-10.5, -0.4, 11.0), (10.5, 26.4, 11.35), "marble", dentils=0.5),
        _box((-10.75, -0.65, 11.35), (10.75, 26.65, 11.75), "marble"),
        _box((-9.9, 0.1, 11.75), (9.9, 25.9, 13.0), "ashlar", block=(1.6, 0.6)),
        _box((-10.1, -0.1, 13.0), (10.1, 26.1, 13.2), "marble"),
    ]
    pilasters = [
        _box((side * 10.4 - 0.2, y - 0.4, PLATFORM), (side * 10.4 + 0.2, y + 0.4, 11.0), "marble")
        for side in (-1, 1)
        for y in (0.6, 5.25, 9.75, 14.25, 18.75, 25.4)
    ]
    return [group(body), group(inside), group(trims), *(group([f]) for f in flanks), group(panes), group(pilasters)]


def cupola() -> list[Group]:
    """Drum with windows and half columns, ribbed dome, lantern with a golden ball and cross."""
    x, y = 0.0, 12.0
    drum = [
        make("frustum", (x, y, 15.2), (6.1, 6.1, 2.6), "drum", radius=6.1, windows=12, sill=-1.2),
        make("frustum", (x, y, 13.4), (6.8, 6.8, 0.35), "marble"),
        make("frustum", (x, y, 17.6), (6.75, 6.75, 0.2), "marble", dentils=0.5),
        make("frustum", (x, y, 17.9), (7.0, 7.0, 0.14), "marble"),
    ]
    for number in range(12):
        angle = number * np.pi / 6
        place = (x + 6.3 * np.cos(angle), y + 6.3 * np.sin(angle), 15.5)
        drum.append(make("frustum", place, (0.34, 0.34, 1.95), "fluted", flutes=10, taper=0.9))
    shell = [make("sphere", (x, y, 18.0), (6.2, 6.2, 6.6), "dome")]
    lantern = [
        make("frustum", (x, y, 24.6), (1.5, 1.5, 0.2), "marble"),
        make("frustum", (x, y, 25.8), (0.85, 0.85, 1.1), "drum", radius=0.85, windows=6, sill=-1.7),
        make("frustum", (x, y, 27.0), (1.35, 1.35, 0.14), "marble"),
        make("frustum", (x, y, 27.9), (1.15, 1.15, 0.8), "metal", colour=VERDIGRIS, taper=0.05),
        make("sphere", (x, y, 28.9), (0.36, 0.36, 0.36), "metal", colour=GOLD),
        _box((x - 0.07, y - 0.07, 29.1), (x + 0.07, y + 0.07, 30.6), "metal", colour=GOLD),
        _box((x - 0.45, y - 0.07, 29.9), (x + 0.45, y + 0.07, 30.05), "metal", colour=GOLD),
    ]
    for number in range(6):
        angle = number * np.pi / 3 + 0.2
        lantern.append(
            make("frustum", (x + 1.15 * np.cos(angle), y + 1.15 * np.sin(angle), 25.8), (0.14, 0.14, 1.1), "marble")
        )
    return [group(drum), group(shell), group(lantern)]


def tower() -> list[Group]:
    """A brick campanile with clocks and an open belfry."""
    x, y = TOWER
    half = 2.35
    openings = [
        make("arch", (x + dx, y + dy, 18.6), (0.72, 3.5, 1.6), "marble", yaw=yaw)
        for yaw, places in ((0, ((-1.05, 0), (1.05, 0))), (90, ((0, -1.05), (0, 1.05))))
        for dx, dy in places
    ]
    slits = [make("arch", (x, y, z), (0.34, 3.5, 1.0), "marble") for z in (4.5, 10.5)]
    shaft = [
        _box(
            (x - half - 0.35, y - half - 0.35, 0), (x + half + 0.35, y + half + 0.35, 1.6), "ashlar", block=(1.4, 0.52)
        ),
        make("box", (x, y, 9.2), (half, half, 7.7), "brick", half=(half, half), band=4.4, offset=1.2, holes=slits),
        make("box", (x, y, 9.2), (0.9, 0.9, 7.0), "glass"),
        _box((x - half - 0.3, y - half - 0.3, 16.9), (x + half + 0.3, y + half + 0.3, 17.3), "marble", dentils=0.4),
    ]
    top = [
        make(
            "box",
            (x, y, 19.5),
            (half - 0.1, half - 0.1, 2.25),
            "brick",
            half=(half - 0.1, half - 0.1),
            band=9.0,
            holes=openings,
        ),
        make("sphere", (x, y, 19.6), (0.75, 0.75, 0.85), "metal", colour=(0.3, 0.2, 0.08)),
        _box((x - half - 0.35, y - half - 0.35, 21.6), (x + half + 0.35, y + half + 0.35, 22.1), "marble", dentils=0.4),
        make("frustum", (x, y, 24.4), (2.5, 2.5, 2.3), "tiles", taper=0.04),
        make("sphere", (x, y, 26.9), (0.28, 0.28, 0.28), "metal", colour=GOLD),
    ]
    faces = (
        ((0, -1), [[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
        ((1, 0), [[0, 1, 0], [0, 0, 1], [1, 0, 0]]),
        ((-1, 0), [[0, -1, 0], [0, 0, 1], [-1, 0, 0]]),
    )
    for (dx, dy), rotation in faces:
        place = (x + dx * half, y + dy * half, 14.4)
        shaft.append(
            make("frustum", place, (1.25, 1.25, 0.12), "clock", rotation=np.array(rotation, float), radius=1.25)
        )
    return [group(shaft), group(top)]


def loggia() -> list[Group]:
    """An arcade on the left flank with a lean-to roof."""
    arches = [make("arch", (x, 3.6, 0.35), (0.95, 1.0, 2.6), "marble") for x in (-21.0, -18.4, -15.8, -13.2)]
    end = make("arch", (-22.3, 7.5, 0.35), (1.1, 1.0, 2.6), "marble", yaw=90)
    return [
        group(
            [
                _box((-22.6, 3.1, 0), (-10.2, 13.2, 0.35), "ashlar", block=(1.6, 0.35)),
                make(
                    "box",
                    (-16.3, 3.6, 2.7),
                    (6.1, 0.32, 2.35),
                    "ashlar",
                    block=(0.8, 0.36),
                    tone=(1.0, 0.93, 0.85),
                    holes=arches,
                ),
                make(
                    "box",
                    (-22.1, 8.0, 2.7),
                    (0.32, 4.7, 2.35),
                    "ashlar",
                    block=(0.8, 0.36),
                    tone=(1.0, 0.93, 0.85),
                    holes=[end],
                ),
                _box((-22.4, 9.0, 0.35), (-10.2, 12.8, 6.6), "brick", half=(6.1, 1.9), band=3.4),
                _box((-22.6, 3.0, 5.05), (-10.2, 9.0, 5.3), "marble", dentils=0.4),
                make("box", (-16.4, 6.1, 6.05), (6.3, 3.3, 0.12), "tiles", ridge="x", rotation=_slope(0.30)),
                make("prism", (-16.4, 10.9, 6.6), (2.3, 6.3, 1.5), "tiles", yaw=90),
            ]
        )
    ]


def _slope(angle):
    """World-to-local rotation of a slab that rises towards +y. angle: radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, s], [0, -s, c]])


def church() -> list[Group]:
    """All of it."""
    return [*steps(), *portico(), *nave(), *cupola(), *tower(), *loggia()]
