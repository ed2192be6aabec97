"""Passers-by: people, umbrellas, cars, vans and buses, made of a few solids each."""

from dataclasses import dataclass

import numpy as np

from samples.plaza_maker.rays import Group, group
from samples.plaza_maker.solids import Solid, limb, make

SKINS = ((0.62, 0.42, 0.31), (0.50, 0.32, 0.22), (0.30, 0.18, 0.11), (0.16, 0.09, 0.06), (0.70, 0.50, 0.39))
HAIR = ((0.03, 0.02, 0.02), (0.12, 0.07, 0.03), (0.38, 0.26, 0.11), (0.34, 0.33, 0.32), (0.22, 0.08, 0.03))
PAINTS = (
    (0.55, 0.04, 0.03),
    (0.05, 0.09, 0.30),
    (0.60, 0.60, 0.60),
    (0.03, 0.03, 0.03),
    (0.66, 0.48, 0.05),
    (0.08, 0.24, 0.14),
)
PLAIN_CLOTH = {"material": "cloth", "other": (0, 0, 0), "pattern": "plain"}


def _dye(rng) -> tuple:
    """A colour for clothes: often dull, sometimes loud."""
    hue = rng.uniform(0, 2 * np.pi)
    loud = rng.choice([0.15, 0.5, 1.0], p=[0.35, 0.35, 0.3])
    value = rng.uniform(0.05, 0.55)
    tone = 0.5 + 0.5 * np.cos(hue + np.array([0, 2.1, 4.2]))
    return tuple(value * (1 - loud + loud * 1.5 * tone))


@dataclass(frozen=True)
class _Body:
    """A person's place, bearing and size. x, y, z: metres, where the feet stand. heading: radians from +x.
    size: of everything, 1 for 1.8 m."""

    x: float
    y: float
    z: float
    heading: float
    size: float

    @property
    def turn(self) -> np.ndarray:
        """World-to-local rotation: x ahead, y to the left."""
        c, s = np.cos(self.heading), np.sin(self.heading)
        return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])

    def at(self, forward: float, left: float, up: float) -> np.ndarray:
        """A place in the world, given in metres of a person of size 1."""
        c, s, size = np.cos(self.heading), np.sin(self.heading), self.size
        return np.array(
            [self.x + size * (forward * c - left * s), self.y + size * (forward * s + left * c), self.z + size * up]
        )

    def limb(self, start, end, start_radius: float, end_radius: float, **params) -> Solid:
        return limb(self.at(*start), self.at(*end), start_radius * self.size, end_radius * self.size, **params)

    def solid(self, kind: str, place, size, **params) -> Solid:
        return make(kind, self.at(*place), np.array(size) * self.size, **params)


def person(rng: np.random.Generator, x: float, y: float, z: float = 0.0) -> Group:
    """Someone walking, waving or holding up a telephone; at times with a bag, hat, skirt or umbrella.

    x, y, z: metres, where the feet stand.
    """
    heading = rng.uniform(0, 2 * np.pi)
    size = rng.uniform(0.92, 1.08) * (0.68 if rng.random() < 0.1 else 1.0)  # some are children
    body = _Body(x, y, z, heading, size)
    pattern = str(rng.choice(["plain", "plain", "stripes", "checks"]))
    shirt = {"material": "cloth", "colour": _dye(rng), "other": _dye(rng), "pattern": pattern}
    trousers = {**PLAIN_CLOTH, "colour": _dye(rng)}
    flesh = {"material": "skin", "colour": SKINS[rng.integers(len(SKINS))]}
    hair = {"material": "skin", "colour": HAIR[rng.integers(len(HAIR))]}
    stride, girth = rng.uniform(0.02, 0.34), rng.uniform(0.9, 1.25)
    parts = [
        *_legs(rng, body, stride, girth, trousers, flesh),
        *_trunk(rng, body, girth, shirt, trousers),
        *_head(body, flesh, hair),
        *_arms(rng, body, stride, girth, shirt, flesh),
        *_belongings(rng, body, shirt),
    ]
    return group(parts, transient=True)


def _legs(rng, body: _Body, stride: float, girth: float, trousers: dict, flesh: dict) -> list[Solid]:
    """Two legs in mid-stride, with shoes; some shins are bare."""
    parts = []
    for side, step in ((1, stride), (-1, -stride)):
        knee, shin = (0.35 * step + 0.05, 0.1 * side, 0.5), flesh if rng.random() < 0.12 else trousers
        parts.append(body.limb((0, 0.1 * side, 0.92), knee, 0.105 * girth, 0.08, **trousers))
        parts.append(body.limb(knee, (step, 0.1 * side, 0.06), 0.08, 0.055, **shin))
        shoe = {"material": "skin", "yaw": np.degrees(body.heading), "colour": (0.05, 0.04, 0.04)}
        parts.append(body.solid("sphere", (step + 0.06, 0.1 * side, 0.05), (0.13, 0.07, 0.06), **shoe))
    return parts


def _trunk(rng, body: _Body, girth: float, shirt: dict, trousers: dict) -> list[Solid]:
    """A skirt at times, chest and shoulders."""
    parts = []
    if rng.random() < 0.25:
        parts.append(
            body.limb((0, 0, 0.45), (0, 0, 1.05), 0.30 * girth, 0.16, **(shirt if rng.random() < 0.5 else trousers))
        )
    parts.append(
        body.solid(
            "frustum", (0, 0, 1.16), (0.115 * girth, 0.165 * girth, 0.27), rotation=body.turn, taper=1.2, **shirt
        )
    )
    parts.append(body.solid("sphere", (0, 0, 1.42), (0.13 * girth, 0.21 * girth, 0.10), rotation=body.turn, **shirt))
    return parts


def _head(body: _Body, flesh: dict, hair: dict) -> list[Solid]:
    return [
        body.limb((0, 0, 1.42), (0.01, 0, 1.56), 0.06, 0.055, **flesh),
        body.solid("sphere", (0.02, 0, 1.65), (0.105, 0.085, 0.125), rotation=body.turn, **flesh),
        body.solid("sphere", (-0.015, 0, 1.685), (0.115, 0.097, 0.118), rotation=body.turn, **hair),
    ]


def _arms(rng, body: _Body, stride: float, girth: float, shirt: dict, flesh: dict) -> list[Solid]:
    """Arms that swing against the legs, wave, or hold up a telephone."""
    parts = []
    gesture = rng.choice(["walk", "phone", "wave"], p=[0.66, 0.24, 0.10])
    for side in (1, -1):
        swing = -side * stride * 0.8
        elbow, hand = (swing * 0.5 - 0.03, 0.25 * side * girth, 1.14), (swing + 0.06, 0.24 * side * girth, 0.88)
        if gesture == "phone" or (gesture == "wave" and side > 0):
            elbow = (0.2, 0.22 * side, 1.24)
            hand = (0.38, 0.05 * side, 1.52) if gesture == "phone" else (0.15, 0.36, 1.86)
        parts.append(body.limb((0, 0.2 * side * girth, 1.43), elbow, 0.058, 0.05, **shirt))
        parts.append(body.limb(elbow, hand, 0.05, 0.038, **(flesh if rng.random() < 0.5 else shirt)))
        parts.append(body.solid("sphere", hand, (0.05, 0.05, 0.06), **flesh))
    if gesture == "phone":
        phone = {"material": "skin", "rotation": body.turn, "colour": (0.02, 0.02, 0.02)}
        parts.append(body.solid("box", (0.41, 0, 1.58), (0.01, 0.05, 0.08), **phone))
    return parts


def _belongings(rng, body: _Body, shirt: dict) -> list[Solid]:
    """A bag on the back, a hat, an umbrella or nothing."""
    chance = rng.random()
    if chance < 0.25:
        bag = {**shirt, "colour": _dye(rng), "pattern": "plain"}
        return [body.solid("sphere", (-0.2, 0, 1.22), (0.14, 0.17, 0.24), rotation=body.turn, **bag)]
    if chance < 0.38:
        brim = body.solid("frustum", (0, 0, 1.74), (0.24, 0.24, 0.015), **PLAIN_CLOTH, colour=_dye(rng))
        crown = body.solid("sphere", (0, 0, 1.76), (0.11, 0.11, 0.09), **PLAIN_CLOTH, colour=_dye(rng))
        return [brim, crown]
    if chance < 0.44:
        stick = body.limb((0.2, 0.16, 1.2), (0.08, 0.1, 2.15), 0.012, 0.012, material="skin", colour=(0.1, 0.1, 0.1))
        hollow = body.solid("sphere", (0.08, 0.1, 1.72), (0.6, 0.6, 0.4), material="cloth")
        gores = {"material": "cloth", "colour": _dye(rng), "other": _dye(rng), "pattern": "gores"}
        return [stick, body.solid("sphere", (0.08, 0.1, 1.86), (0.56, 0.56, 0.34), holes=[hollow], **gores)]
    return []


def _wheels(
    x: float, y: float, heading: float, places: list[tuple[float, float]], radius: float, width: float
) -> list[Solid]:
    """Wheels at (forward, left) places of a vehicle. Metres, radians."""
    c, s = np.cos(heading), np.sin(heading)
    axle = np.array([[c, s, 0], [0, 0, 1], [s, -c, 0]])
    wheel = {"size": (radius, radius, width), "material": "tyre", "rotation": axle, "radius": radius}
    return [
        make("frustum", (x + forward * c - left * s, y + forward * s + left * c, radius), **wheel)
        for forward, left in places
    ]


def car(rng: np.random.Generator, x: float, y: float, heading: float) -> Group:
    """A saloon or a taxi. Metres, radians."""
    c, s = np.cos(heading), np.sin(heading)
    body = {"material": "paint", "yaw": np.degrees(heading), "colour": PAINTS[rng.integers(len(PAINTS))]}
    long, wide = rng.uniform(2.0, 2.3), 0.85
    without_panes = {"panes": (5.0, 6.0), "pane": 9.0}  # higher than the car
    hull = make("box", (x, y, 0.62), (long, wide, 0.26), half=(long, wide, 0.26), **without_panes, **body)
    bonnet_at = (x + 0.66 * long * c, y + 0.66 * long * s, 0.78)
    bonnet = make("sphere", bonnet_at, (0.75, wide * 0.98, 0.2), half=(1, 1, 1), lights=0.0, **without_panes, **body)
    glazing = {"half": (long * 0.62, wide, 0.32), "panes": (-0.26, 0.2), "pane": 1.3}
    cabin = make(
        "frustum", (x - 0.15 * c, y - 0.15 * s, 1.16), (0.62 * long, wide * 0.92, 0.32), taper=0.72, **glazing, **body
    )
    places = [(end * long * 0.62, side * (wide - 0.05)) for end in (-1, 1) for side in (-1, 1)]
    return group([hull, bonnet, cabin, *_wheels(x, y, heading, places, 0.33, 0.12)], transient=True)


def bus(rng: np.random.Generator, x: float, y: float, heading: float, van: bool = False) -> Group:
    """A coach of some ten metres, or a delivery van of five. Metres, radians."""
    degrees = np.degrees(heading)
    long, tall = (2.5, 0.85) if van else (rng.uniform(4.2, 5.4), 1.3)
    wide = 0.98 if van else 1.22
    paint = {"colour": PAINTS[rng.integers(len(PAINTS))], "band": PAINTS[rng.integers(len(PAINTS))]}
    panes = (
        {"panes": (0.15, 0.6), "pane": 5.0, "inside": 0.0}
        if van
        else {"panes": (-0.1, 0.75), "pane": 1.35, "inside": 0.8}
    )
    body = make(
        "box", (x, y, 0.42 + tall), (long, wide, tall), "paint", yaw=degrees, half=(long, wide, tall), **paint, **panes
    )
    roof = make(
        "box", (x, y, 0.5 + 2 * tall), (long * 0.85, wide * 0.85, 0.1), "skin", yaw=degrees, colour=(0.5, 0.5, 0.5)
    )
    places = [(end * long * 0.66, side * (wide - 0.08)) for end in (-1, 1) for side in (-1, 1)]
    return group([body, roof, *_wheels(x, y, heading, places, 0.4 if van else 0.48, 0.13)], transient=True)


def parasol(rng: np.random.Generator, x: float, y: float) -> Group:
    """A street seller's parasol over a cart."""
    hue = {"colour": _dye(rng), "other": (0.7, 0.68, 0.62), "pattern": "gores"}
    parts = [
        make("box", (x, y, 0.75), (0.9, 0.5, 0.35), "cloth", yaw=rng.uniform(0, 180), **{**hue, "pattern": "stripes"}),
        limb((x, y, 0.4), (x, y, 2.7), 0.035, 0.035, "skin", colour=(0.3, 0.3, 0.3)),
        make("frustum", (x, y, 2.5), (1.5, 1.5, 0.3), "cloth", taper=0.06, **hue),
        *_wheels(x, y, 0.0, [(0.5, -0.5), (0.5, 0.5)], 0.35, 0.04),
    ]
    return group(parts, transient=True)
