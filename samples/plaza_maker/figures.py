"""Passers-by: people, umbrellas, cars, vans and buses, made of a few solids each."""

import numpy as np

from samples.plaza_maker.rays import Group, group
from samples.plaza_maker.solids import limb, make

SKINS = ((0.62, 0.42, 0.31), (0.50, 0.32, 0.22), (0.30, 0.18, 0.11), (0.16, 0.09, 0.06), (0.70, 0.50, 0.39))
HAIR = ((0.03, 0.02, 0.02), (0.12, 0.07, 0.03), (0.38, 0.26, 0.11), (0.34, 0.33, 0.32), (0.22, 0.08, 0.03))
PAINTS = ((0.55, 0.04, 0.03), (0.05, 0.09, 0.30), (0.60, 0.60, 0.60), (0.03, 0.03, 0.03), (0.66, 0.48, 0.05), (0.08, 0.24, 0.14))


def _dye(rng) -> tuple:
    """A colour for clothes: often dull, sometimes loud."""
    hue = rng.uniform(0, 2 * np.pi)
    loud = rng.choice([0.15, 0.5, 1.0], p=[0.35, 0.35, 0.3])
    value = rng.uniform(0.05, 0.55)
    tone = 0.5 + 0.5 * np.cos(hue + np.array([0, 2.1, 4.2]))
    return tuple(value * (1 - loud + loud * 1.5 * tone))


def person(rng: np.random.Generator, x: float, y: float, z: float = 0.0) -> Group:
    """Someone walking, waving or holding up a telephone; at times with a bag, hat, skirt or umbrella.

    x, y, z: metres, where the feet stand.
    """
    heading = rng.uniform(0, 2 * np.pi)  # radians from +x
    size = rng.uniform(0.92, 1.08) * (0.68 if rng.random() < 0.1 else 1.0)
    c, s = np.cos(heading), np.sin(heading)

    def at(forward, left, up):
        return np.array([x + size * (forward * c - left * s), y + size * (forward * s + left * c), z + size * up])

    def body(start, end, first, second, **params):
        return limb(at(*start), at(*end), first * size, second * size, **params)

    pattern = str(rng.choice(["plain", "plain", "stripes", "checks"]))
    shirt = {"material": "cloth", "colour": _dye(rng), "other": _dye(rng), "pattern": pattern}
    legs = {"material": "cloth", "colour": _dye(rng), "other": (0, 0, 0), "pattern": "plain"}
    flesh = {"material": "skin", "colour": SKINS[rng.integers(len(SKINS))]}
    hair = {"material": "skin", "colour": HAIR[rng.integers(len(HAIR))]}
    stride, girth = rng.uniform(0.02, 0.34), rng.uniform(0.9, 1.25)
    parts = []
    for side, step in ((1, stride), (-1, -stride)):
        knee, bare = (0.35 * step + 0.05, 0.1 * side, 0.5), rng.random() < 0.12
        parts.append(body((0, 0.1 * side, 0.92), knee, 0.105 * girth, 0.08, **legs))
        parts.append(body(knee, (step, 0.1 * side, 0.06), 0.08, 0.055, **(flesh if bare else legs)))
        parts.append(
            make(
                "sphere",
                at(step + 0.06, 0.1 * side, 0.05),
                np.array([0.13, 0.07, 0.06]) * size,
                "skin",
                yaw=np.degrees(heading),
                colour=(0.05, 0.04, 0.04),
            )
        )
    if rng.random() < 0.25:
        parts.append(body((0, 0, 0.45), (0, 0, 1.05), 0.30 * girth, 0.16, **(shirt if rng.random() < 0.5 else legs)))
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    parts.append(make("frustum", at(0, 0, 1.16), np.array([0.115 * girth, 0.165 * girth, 0.27]) * size, rotation=turn, taper=1.2, **shirt))
    parts.append(make("sphere", at(0, 0, 1.42), np.array([0.13 * girth, 0.21 * girth, 0.10]) * size, rotation=turn, **shirt))
    parts.append(body((0, 0, 1.42), (0.01, 0, 1.56), 0.06, 0.055, **flesh))
    parts.append(make("sphere", at(0.02, 0, 1.65), np.array([0.105, 0.085, 0.125]) * size, rotation=turn, **flesh))
    parts.append(make("sphere", at(-0.015, 0, 1.685), np.array([0.115, 0.097, 0.118]) * size, rotation=turn, **hair))
    gesture = rng.choice(["walk", "phone", "wave"], p=[0.66, 0.24, 0.10])
    for side in (1, -1):
        swing = -side * stride * 0.8
        elbow, hand = (swing * 0.5 - 0.03, 0.25 * side * girth, 1.14), (swing + 0.06, 0.24 * side * girth, 0.88)
        if gesture == "phone" or (gesture == "wave" and side > 0):
            elbow = (0.2, 0.22 * side, 1.24)
            hand = (0.38, 0.05 * side, 1.52) if gesture == "phone" else (0.15, 0.36, 1.86)
        parts.append(body((0, 0.2 * side * girth, 1.43), elbow, 0.058, 0.05, **shirt))
        parts.append(body(elbow, hand, 0.05, 0.038, **(flesh if rng.random() < 0.5 else shirt)))
        parts.append(make("sphere", at(*hand), np.array([0.05, 0.05, 0.06]) * size, **flesh))
    if gesture == "phone":
        parts.append(make("box", at(0.41, 0, 1.58), np.array([0.01, 0.05, 0.08]) * size, "skin", rotation=turn, colour=(0.02, 0.02, 0.02)))
    extra = rng.random()
    if extra < 0.25:
        parts.append(
            make(
                "sphere", at(-0.2, 0, 1.22), np.array([0.14, 0.17, 0.24]) * size, rotation=turn, **{**shirt, "colour": _dye(rng), "pattern": "plain"}
            )
        )
    elif extra < 0.38:
        parts.append(
            make("frustum", at(0, 0, 1.74), np.array([0.24, 0.24, 0.015]) * size, "cloth", colour=_dye(rng), other=(0, 0, 0), pattern="plain")
        )
        parts.append(make("sphere", at(0, 0, 1.76), np.array([0.11, 0.11, 0.09]) * size, "cloth", colour=_dye(rng), other=(0, 0, 0), pattern="plain"))
    elif extra < 0.44:
        parts.append(body((0.2, 0.16, 1.2), (0.08, 0.1, 2.15), 0.012, 0.012, material="skin", colour=(0.1, 0.1, 0.1)))
        canopy = make(
            "sphere",
            at(0.08, 0.1, 1.86),
            np.array([0.56, 0.56, 0.34]) * size,
            "cloth",
            colour=_dye(rng),
            other=_dye(rng),
            pattern="gores",
            holes=[make("sphere", at(0.08, 0.1, 1.72), np.array([0.6, 0.6, 0.4]) * size, "cloth")],
        )
        parts.append(canopy)
    return group(parts, transient=True)


def _wheels(x, y, c, s, places, radius, width):
    """Wheels at (forward, left) places of a vehicle that heads along (c, s)."""
    axle = np.array([[c, s, 0], [0, 0, 1], [s, -c, 0]])
    return [
        make("frustum", (x + f * c - a * s, y + f * s + a * c, radius), (radius, radius, width), "tyre", rotation=axle, radius=radius)
        for f, a in places
    ]


def car(rng: np.random.Generator, x: float, y: float, heading: float) -> Group:
    """A saloon or a taxi. Metres, radians."""
    c, s = np.cos(heading), np.sin(heading)
    degrees = np.degrees(heading)
    paint = PAINTS[rng.integers(len(PAINTS))]
    long, wide = rng.uniform(2.0, 2.3), 0.85
    cabin = make(
        "frustum",
        (x - 0.15 * c, y - 0.15 * s, 1.16),
        (0.62 * long, wide * 0.92, 0.32),
        "paint",
        yaw=degrees,
        taper=0.72,
        colour=paint,
        half=(long * 0.62, wide, 0.32),
        panes=(-0.26, 0.2),
        pane=1.3,
    )
    parts = [
        make("box", (x, y, 0.62), (long, wide, 0.26), "paint", yaw=degrees, colour=paint, half=(long, wide, 0.26), panes=(5.0, 6.0), pane=9.0),
        make(
            "sphere",
            (x + 0.66 * long * c, y + 0.66 * long * s, 0.78),
            (0.75, wide * 0.98, 0.2),
            "paint",
            yaw=degrees,
            colour=paint,
            half=(1, 1, 1),
            panes=(5.0, 6.0),
            pane=9.0,
            lights=0.0,
        ),
        cabin,
        *_wheels(x, y, c, s, [(f * long * 0.62, side * (wide - 0.05)) for f in (-1, 1) for side in (-1, 1)], 0.33, 0.12),
    ]
    return group(parts, transient=True)


def bus(rng: np.random.Generator, x: float, y: float, heading: float, van: bool = False) -> Group:
    """A coach of some ten metres, or a delivery van of five. Metres, radians."""
    c, s = np.cos(heading), np.sin(heading)
    degrees = np.degrees(heading)
    long, tall = (2.5, 0.85) if van else (rng.uniform(4.2, 5.4), 1.3)
    wide = 0.98 if van else 1.22
    paint, band = PAINTS[rng.integers(len(PAINTS))], PAINTS[rng.integers(len(PAINTS))]
    panes = (0.15, 0.6) if van else (-0.1, 0.75)
    body = make(
        "box",
        (x, y, 0.42 + tall),
        (long, wide, tall),
        "paint",
        yaw=degrees,
        colour=paint,
        band=band,
        half=(long, wide, tall),
        panes=panes,
        pane=5.0 if van else 1.35,
        inside=0.0 if van else 0.8,
    )
    places = [(f * long * 0.66, side * (wide - 0.08)) for f in (-1, 1) for side in (-1, 1)]
    roof = make("box", (x, y, 0.5 + 2 * tall), (long * 0.85, wide * 0.85, 0.1), "skin", yaw=degrees, colour=(0.5, 0.5, 0.5))
    return group([body, roof, *_wheels(x, y, c, s, places, 0.4 if van else 0.48, 0.13)], transient=True)


def parasol(rng: np.random.Generator, x: float, y: float) -> Group:
    """A street seller's parasol over a cart."""
    hue = {"colour": _dye(rng), "other": (0.7, 0.68, 0.62), "pattern": "gores"}
    parts = [
        make("box", (x, y, 0.75), (0.9, 0.5, 0.35), "cloth", yaw=rng.uniform(0, 180), **{**hue, "pattern": "stripes"}),
        limb((x, y, 0.4), (x, y, 2.7), 0.035, 0.035, "skin", colour=(0.3, 0.3, 0.3)),
        make("frustum", (x, y, 2.5), (1.5, 1.5, 0.3), "cloth", taper=0.06, **hue),
        *_wheels(x, y, 1.0, 0.0, [(0.5, -0.5), (0.5, 0.5)], 0.35, 0.04),
    ]
    return group(parts, transient=True)
