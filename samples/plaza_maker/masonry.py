"""The building's materials: stone, brick, tiles, glass, relief.
Each is a function of points on a solid that returns their Surface.

point, normal: (3, N), in the solid's local metres. footprint: (N,) metres that a sample spans. params: those of the
solid.
"""

from functools import cache

import cv2
import numpy as np

from samples.plaza_maker.noise import fractal, mix, scatter, stripe, within
from samples.plaza_maker.surface import Surface, colour, engraved, sample, wall_coordinates, wall_tilt

LIMESTONE, SHADE, GROUT = colour(0.66, 0.59, 0.47), colour(0.47, 0.41, 0.32), colour(0.22, 0.19, 0.16)
BRICK, BRICK_DARK, MORTAR = colour(0.50, 0.22, 0.13), colour(0.31, 0.13, 0.09), colour(0.58, 0.52, 0.44)
COPPER, VERDIGRIS, GOLD = colour(0.25, 0.17, 0.11), colour(0.26, 0.47, 0.39), colour(0.75, 0.52, 0.16)
LAMPLIGHT = colour(1.0, 0.62, 0.26)


def _courses(u, v, length, height, joint, footprint):
    """Staggered courses: joint coverage, cell numbers, and the slopes of the chamfers along u and v."""
    row = np.floor(v / height)
    shifted = u + 0.5 * length * (row % 2) + 0.37 * length * scatter(row, seed=5)
    joints = np.maximum(stripe(shifted, length, joint, footprint), stripe(v, height, joint, footprint))
    sharp = np.clip(1 - footprint / (4 * joint), 0, 1)
    fu, fv = (shifted / length) % 1, (v / height) % 1
    edge_u, edge_v = 3.0 * joint / length, 3.0 * joint / height
    slope_u = ((fu > 1 - edge_u).astype(np.float32) - (fu < edge_u)) * 0.7 * sharp
    slope_v = ((fv > 1 - edge_v).astype(np.float32) - (fv < edge_v)) * 0.7 * sharp
    return joints, np.floor(shifted / length), row, slope_u, slope_v


def ashlar(point, normal, footprint, params):
    """Blocks of weathered limestone; `block` = (length, height) in metres, `tone` tints it."""
    u, v, axis = wall_coordinates(point, normal)
    length, height = params.get("block", (1.1, 0.48))
    joints, column, row, slope_u, slope_v = _courses(u, v, length, height, 0.045, footprint)
    tint = scatter(column, row, axis, seed=11)
    grain = fractal(u * 3.1, v * 3.1, 21, 4)
    streak = fractal(u * 1.7, v * 0.16, 31, 3)
    albedo = mix(LIMESTONE, SHADE, np.clip(0.75 * tint + 1.1 * (grain - 0.5) + 0.9 * (streak - 0.45), 0, 1))
    albedo = mix(albedo, GROUT, joints * 0.85) * np.asarray(params.get("tone", (1, 1, 1)), np.float32)[:, None]
    return Surface(albedo, wall_tilt(slope_u + 0.5 * (grain - 0.5), slope_v, axis))


def marble(point, normal, footprint, params):
    """Pale stone with veins: cornices, statues, capitals."""
    u, v, _ = wall_coordinates(point, normal)
    grain = fractal(u * 2.3 + point[1], v * 2.3, 41, 4)
    vein = np.clip(1 - np.abs(fractal(u * 0.9, v * 0.9 + point[1], 43, 4) - 0.5) * 14, 0, 1)
    albedo = mix(LIMESTONE * 1.12, SHADE * 1.15, np.clip(1.6 * grain - 0.45, 0, 1))
    albedo = mix(albedo, SHADE * 0.7, 0.5 * vein)
    if "dentils" in params:  # a toothed band under a cornice
        period = params["dentils"]
        teeth = stripe(u, period, period / 2, footprint) * (np.abs(normal[2]) < 0.5)
        albedo = mix(albedo, albedo * 0.45, teeth)
    return Surface(albedo * np.asarray(params.get("tone", (1, 1, 1)), np.float32)[:, None])


def fluted(point, normal, footprint, params):
    """A column's shaft: flutes that catch the sun on one flank, drums, veins."""
    angle = np.arctan2(point[1], point[0])
    count = params.get("flutes", 20)
    radius = np.hypot(point[0], point[1])
    sharp = np.clip(1.3 - footprint * count / (2.2 * radius), 0, 1) * (np.abs(normal[2]) < 0.5)
    wave = np.sin(angle * count) * sharp
    drum = stripe(point[2], 1.45, 0.04, footprint)
    grain = fractal(angle * 3, point[2] * 0.7, 51, 4)
    albedo = mix(LIMESTONE * 1.1, SHADE * 0.95, np.clip(1.5 * grain - 0.4, 0, 1)) * (
        1 - 0.30 * sharp * (1 - np.cos(angle * count)) / 2
    )
    tilt = np.stack([-np.sin(angle) * wave, np.cos(angle) * wave, np.zeros_like(wave)]) * 0.9
    return Surface(mix(albedo, GROUT, 0.6 * drum), tilt)


def brick(point, normal, footprint, params):
    """Brickwork with a stone band every `band` metres, and stone quoins where `half` gives the wall's half widths."""
    u, v, axis = wall_coordinates(point, normal)
    joints, column, row, slope_u, slope_v = _courses(u, v, 0.42, 0.16, 0.03, footprint)
    fade = np.clip(1 - footprint / 0.3, 0, 1)
    tint = scatter(column, row, axis, seed=61) * fade + 0.5 * (1 - fade)
    patches = fractal(u * 0.5, v * 0.5, 63, 4)
    albedo = mix(BRICK, BRICK_DARK, np.clip(tint * 0.9 + 1.5 * (patches - 0.5), 0, 1))
    albedo = mix(albedo, MORTAR, joints)
    band = stripe(v + params.get("offset", 0.0), params["band"], 0.34, footprint)
    half = params.get("half", (1e3, 1e3))
    width = np.where(axis == 0, half[1], half[0])
    rows = np.floor(v / 0.5) % 2
    quoin = np.clip((np.abs(u) - (width - 0.42 - 0.3 * rows)) / np.maximum(footprint, 1e-3) + 0.5, 0, 1)
    stone = np.maximum(band, quoin)
    albedo = mix(albedo, LIMESTONE[:, None] * (0.8 + 0.4 * fractal(u * 2, v * 2, 65, 3)), stone)
    return Surface(albedo, wall_tilt(slope_u * (1 - stone) * 0.6, slope_v * (1 - stone) * 0.6, axis))


def tiles(point, normal, footprint, params):
    """Roman roof tiles: barrels along u, rows down the slope."""
    along, down = (point[1], point[0]) if params.get("ridge", "y") == "y" else (point[0], point[1])
    sharp = np.clip(1 - footprint / 0.45, 0, 1)
    wave = np.sin(along * 2 * np.pi / 0.42) * sharp
    rows = stripe(down, 0.55, 0.09, footprint)
    tint = scatter(np.floor(along / 0.42), np.floor(down / 0.55), seed=71) * sharp + 0.5 * (1 - sharp)
    moss = fractal(along * 0.6, down * 0.6, 73, 3)
    albedo = mix(colour(0.58, 0.27, 0.15), colour(0.36, 0.17, 0.10), np.clip(tint + 1.2 * (moss - 0.5), 0, 1))
    albedo = mix(albedo, albedo * 0.35, np.maximum(rows, 0.5 * (1 - wave) * sharp * 0.6))
    tilt = np.zeros_like(point)
    tilt[1 if params.get("ridge", "y") == "y" else 0] = 0.8 * wave
    return Surface(albedo, tilt)


def dome(point, normal, footprint, params):
    """Copper gone green, in gores between gilded ribs, with rain streaks and a row of oculi."""
    angle = np.arctan2(point[1], point[0])
    ring = np.hypot(point[0], point[1])
    gores = 16
    across = (angle * gores / (2 * np.pi)) % 1 - 0.5
    metres = across * 2 * np.pi * ring / gores
    rib = within(metres, -0.17, 0.17, footprint)
    height = np.arctan2(point[2], ring)
    plates = np.maximum(stripe(height * 6, 0.8, 0.05, footprint), stripe(metres, 0.62, 0.04, footprint))
    streak = fractal(angle * 26, height * 1.3, 81, 4)
    albedo = mix(VERDIGRIS, COPPER, np.clip(1.9 * streak - 0.6, 0, 1))
    albedo = mix(albedo, albedo * 0.5, plates)
    disc = np.hypot(metres, (height - 0.42) * 6.3)
    oculus = np.clip((0.62 - disc) / np.maximum(footprint, 1e-3) + 0.5, 0, 1)
    frame = np.clip((0.85 - disc) / np.maximum(footprint, 1e-3) + 0.5, 0, 1)
    albedo = mix(mix(albedo, GOLD, np.maximum(rib, frame)), colour(0.03, 0.03, 0.04), oculus)
    slope = np.clip(metres / 0.17, -1, 1) * rib * 1.1
    tilt = np.stack([-np.sin(angle) * slope, np.cos(angle) * slope, np.zeros_like(slope)])
    return Surface(albedo, tilt, oculus * LAMPLIGHT[:, None] * 0.5, 0.10)


def drum(point, normal, footprint, params):
    """The cylinder under the dome: stone with tall round-headed windows."""
    angle = np.arctan2(point[1], point[0])
    radius, count = params["radius"], params["windows"]
    across = ((angle * count / (2 * np.pi)) % 1 - 0.5) * 2 * np.pi * radius / count
    surface = ashlar(
        np.stack([angle * radius, -np.full_like(angle, radius), point[2]]),
        np.stack([0 * angle, -1 + 0 * angle, 0 * angle]),
        footprint,
        {},
    )
    top = point[2] - params["sill"] - 1.7
    distance = np.where(top > 0, np.hypot(across, top), np.maximum(np.abs(across), -(point[2] - params["sill"]) + 0.55))
    blur = np.maximum(footprint, 1e-3)
    pane, frame = np.clip((0.55 - distance) / blur + 0.5, 0, 1), np.clip((0.82 - distance) / blur + 0.5, 0, 1)
    bars = np.maximum(stripe(across, 0.36, 0.06, footprint), stripe(point[2], 0.45, 0.06, footprint))
    glass = mix(colour(0.05, 0.07, 0.10), colour(0.25, 0.23, 0.2), bars)
    albedo = mix(mix(surface.albedo, LIMESTONE * 1.2, frame), glass, pane)
    return Surface(albedo, None, LAMPLIGHT[:, None] * pane * (1 - bars) * 0.9, 0.25 * pane)


def glass(point, normal, footprint, params):
    """Leaded coloured panes, lit from inside by night."""
    u, v, _ = wall_coordinates(point, normal)
    slanted, other = (u + v) / 0.42, (u - v) / 0.42
    lead = np.maximum(stripe(u + v, 0.42, 0.05, footprint), stripe(u - v, 0.42, 0.05, footprint))
    hue = scatter(np.floor(slanted), np.floor(other), seed=91)
    pane = np.stack([0.5 + 0.5 * np.cos(6.283 * (hue + shift)) for shift in (0.0, 0.35, 0.62)]).astype(np.float32)
    albedo = mix(0.04 + 0.13 * pane, colour(0.03, 0.03, 0.03), lead)
    return Surface(albedo, None, (0.35 + 0.9 * pane) * LAMPLIGHT[:, None] * (1 - lead) * 0.8, 0.25)


def bronze_door(point, normal, footprint, params):
    """Two wings of square panels with studs."""
    u, v = point[0], point[2]
    frame = np.maximum(stripe(u, 0.8, 0.12, footprint), stripe(v, 0.9, 0.12, footprint))
    boss = np.clip(
        (0.17 - np.hypot((u / 0.8 % 1 - 0.5) * 0.8, (v / 0.9 % 1 - 0.5) * 0.9)) / np.maximum(footprint, 1e-3), 0, 1
    )
    patina = fractal(u * 4, v * 2, 101, 4)
    albedo = mix(
        mix(colour(0.20, 0.13, 0.07), colour(0.13, 0.22, 0.17), np.clip(2 * patina - 0.6, 0, 1)),
        colour(0.36, 0.24, 0.1),
        np.maximum(frame, boss),
    )
    return Surface(albedo, None, None, 0.12)


@cache
def _relief() -> np.ndarray:
    """Heights in [0, 1] of the pediment's frieze: a disc with rays between walking figures, as (256, 1024)."""
    picture = np.zeros((256, 1024), np.uint8)
    cv2.circle(picture, (512, 150), 66, 120, -1)
    cv2.circle(picture, (512, 150), 40, 230, -1)
    for turn in range(16):
        c, s = np.cos(turn * np.pi / 8), np.sin(turn * np.pi / 8)
        cv2.line(picture, (int(512 + 46 * c), int(150 + 46 * s)), (int(512 + 84 * c), int(150 + 84 * s)), 200, 7)
    rng = np.random.default_rng(8)
    for side in (-1, 1):
        for step in range(5):
            x, tall = 512 + side * (118 + 62 * step), 165 - 27 * step
            cv2.ellipse(picture, (x, 236 - tall // 2), (15, tall // 3), rng.uniform(-9, 9), 0, 360, 190, -1)
            cv2.circle(picture, (x + int(rng.integers(-5, 6)), 236 - int(tall * 0.87)), 11, 230, -1)
            reach = (x + side * int(rng.integers(18, 34)), 236 - int(tall * rng.uniform(0.5, 0.95)))
            cv2.line(picture, (x, 236 - int(tall * 0.65)), reach, 210, 8)
            for foot in (-9, 9):
                cv2.line(picture, (x, 236 - tall // 3), (x + foot, 244), 180, 9)
    return cv2.GaussianBlur(picture, (0, 0), 3.2).astype(np.float32) / 255


def relief(point, normal, footprint, params):
    """The pediment: figures in relief on its face, whose shading follows the sun."""
    half, _, height = params["triangle"]
    u, v = point[0] / (2 * half) + 0.5, point[2] / height * 0.95 + 0.03
    step = 1 / 1024
    heights = sample(_relief(), u, v)
    slope_u = (sample(_relief(), u + step, v) - sample(_relief(), u - step, v)) * 14
    slope_v = (sample(_relief(), u, v + 4 * step) - sample(_relief(), u, v - 4 * step)) * 14
    grain = fractal(point[0] * 3, point[2] * 3, 111, 3)
    albedo = mix(colour(0.36, 0.32, 0.28), LIMESTONE * 1.2, np.clip(heights * 1.4, 0, 1)) * (0.75 + 0.5 * grain)
    face = normal[1] < -0.5
    tilt = np.stack([-slope_u * face, 0 * slope_u, -slope_v * face])
    return Surface(np.where(face, albedo, LIMESTONE[:, None] * (0.75 + 0.5 * grain)).astype(np.float32), tilt)


def inscription(point, normal, footprint, params):
    """Stone with text cut into its front: `lines`, over `area` = (x, z, width, height) in local metres."""
    surface = marble(point, normal, footprint, params)
    x, z, width, height = params["area"]
    picture = engraved(params["lines"], params["shape"], params["scale"], params["thickness"])
    u, v = (point[0] - x) / width, (point[2] - z) / height
    inside = (normal[1] < -0.5) & (u > 0) & (u < 1) & (v > 0) & (v < 1)
    cut = np.where(inside, sample(picture, u, v), 0)
    return Surface(mix(surface.albedo, params.get("ink", GROUT * 0.6), cut))


@cache
def _clock() -> np.ndarray:
    picture = np.full((256, 256), 225, np.uint8)
    cv2.circle(picture, (128, 128), 122, 20, 9)
    for hour in range(12):
        c, s = np.sin(hour * np.pi / 6), -np.cos(hour * np.pi / 6)
        cv2.line(picture, (int(128 + 84 * c), int(128 + 84 * s)), (int(128 + 108 * c), int(128 + 108 * s)), 10, 9)
    cv2.line(picture, (128, 128), (128 + 44, 128 - 26), 0, 13)
    cv2.line(picture, (128, 128), (128 - 22, 128 - 76), 0, 8)
    return picture.astype(np.float32) / 255


def clock(point, normal, footprint, params):
    """A white dial with hands, on the flat ends of a drum; lit by night."""
    radius = params["radius"]
    dial = sample(_clock(), point[0] / (2 * radius) + 0.5, point[1] / (2 * radius) + 0.5)
    face = np.abs(normal[2]) > 0.5
    albedo = np.where(face, dial, 0.25)[None] * colour(0.85, 0.82, 0.72)[:, None]
    return Surface(albedo.astype(np.float32), None, (face * dial)[None] * colour(0.9, 0.8, 0.55)[:, None] * 0.7)
