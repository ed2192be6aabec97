"""Materials of the plaza, its trees, houses, people and vehicles: functions like those in masonry.py."""

import numpy as np

from samples.plaza_maker.masonry import LAMPLIGHT
from samples.plaza_maker.noise import fractal, mix, scatter, stripe, within
from samples.plaza_maker.surface import Surface, colour, wall_coordinates, wall_tilt


def paving(point, normal, footprint, params):
    """The ground: travertine bands over basalt setts, rings round the fountain, asphalt and grass farther out."""
    x, y = point[0], point[1]
    fx, fy = params["fountain"]
    radius, angle = np.hypot(x - fx, y - fy), np.arctan2(y - fy, x - fx)
    ringed = radius < 8.0
    u = np.where(ringed, angle * np.round(radius * 2) * 1.2, x * 2.0 + 0.5 * (np.floor(y * 2.6) % 2))
    v = np.where(ringed, radius * 2.6, y * 2.6)
    sharp = np.clip(1.2 - footprint / 0.45, 0, 1)
    tint = scatter(np.floor(u), np.floor(v), seed=121) * sharp + 0.5 * (1 - sharp)
    joints = np.maximum(stripe(u, 1.0, 0.13, footprint * 2.2), stripe(v, 1.0, 0.13, footprint * 2.6))
    wear = fractal(x * 0.35, y * 0.35, 123, 4)
    setts = mix(colour(0.27, 0.25, 0.24), colour(0.15, 0.14, 0.14), np.clip(tint * 1.1 + 1.2 * (wear - 0.5), 0, 1))
    setts = mix(setts, colour(0.09, 0.085, 0.08), joints)
    grid = np.maximum(stripe(x, 6.0, 0.7, footprint), stripe(y, 6.0, 0.7, footprint)) * ~ringed
    rings = stripe(radius - 0.2, 2.0, 0.5, footprint) * ringed
    rays = within(np.abs((angle * 8 / np.pi) % 2 - 1) * radius * np.pi / 8, -1, 0.22, footprint) * ringed
    pale = np.maximum(grid, np.maximum(rings, rays))
    travertine = colour(0.56, 0.52, 0.44)[:, None] * (0.75 + 0.5 * fractal(x * 2, y * 2, 125, 3))
    albedo = mix(setts, travertine, pale * 0.9)
    street = np.clip((np.hypot(x, (y - 4) * 0.95) - 41) / np.maximum(footprint, 0.02), 0, 1)
    line = stripe(np.hypot(x, (y - 4) * 0.95) - 46.0, 400, 0.25, footprint) * (np.sin(np.arctan2(y - 4, x) * 90) > 0)
    asphalt = mix(colour(0.10, 0.10, 0.105)[:, None] * (0.8 + 0.4 * wear), colour(0.55, 0.55, 0.52), line)
    albedo = mix(albedo, asphalt, street)
    beyond = np.clip((np.hypot(x, (y - 4) * 0.95) - 52) / np.maximum(footprint, 0.02), 0, 1)
    albedo = mix(albedo, colour(0.23, 0.22, 0.19)[:, None] * (0.7 + 0.6 * wear), beyond)
    slope = (tint - 0.5) * 0.25 * sharp * (1 - pale)
    return Surface(albedo, np.stack([slope, -slope, 0 * slope]), None, 0.02)


def foliage(point, normal, footprint, params):
    """Leaves: dark and light clumps at two scales."""
    u, v = point[0] + 0.7 * point[1] + params.get("offset", 0.0), point[2] - 0.5 * point[1]
    clump = fractal(u * 3.2, v * 3.2, 131, 2)
    leaf = fractal(u * 11, v * 11, 133, 2)
    shade = np.clip(1.4 * clump + 0.9 * leaf - 0.75, 0, 1)
    albedo = mix(colour(0.035, 0.07, 0.02), np.asarray(params.get("leaf", (0.16, 0.25, 0.07)), np.float32), shade)
    return Surface(albedo, np.stack([clump - 0.5, leaf - 0.5, 0.7 * (leaf - clump)]) * 1.8)


def bark(point, normal, footprint, params):
    """A trunk."""
    grain = fractal(np.arctan2(point[1], point[0]) * 5, point[2] * 1.5, 141, 3)
    return Surface(mix(colour(0.20, 0.15, 0.11), colour(0.08, 0.06, 0.05), grain))


def water(point, normal, footprint, params):
    """Rippled water that mirrors the sky."""
    ripple = fractal(point[0] * 5, point[1] * 5, 151, 3) - 0.5
    other = fractal(point[0] * 5 + 9, point[1] * 5, 157, 3) - 0.5
    albedo = np.broadcast_to(colour(0.05, 0.13, 0.14)[:, None], point.shape)
    return Surface(albedo * (1 + ripple), np.stack([ripple, other, 0 * ripple]) * 0.7, None, 0.35)


def metal(point, normal, footprint, params):
    """Dark cast metal, or bronze gone green by the param `colour`."""
    base = np.asarray(params.get("colour", (0.07, 0.075, 0.07)), np.float32)
    rust = fractal(point[0] * 4 + point[1], point[2] * 3, 161, 3)
    return Surface(base[:, None] * (0.5 + rust), None, None, 0.12)


def lamp(point, normal, footprint, params):
    """A milk-glass globe, lit by night."""
    ones = np.ones((1, point.shape[1]), np.float32)
    return Surface(ones * colour(0.8, 0.8, 0.75)[:, None], None, ones * LAMPLIGHT[:, None] * 3.0)


def house(point, normal, footprint, params):
    """Plastered storeys with shuttered windows, of which some are lit by night."""
    u, v, axis = wall_coordinates(point, normal)
    seed = params["seed"]
    storey, bay = 3.1, 2.4
    column, row = np.floor(u / bay), np.floor(v / storey)
    x, y = (u / bay) % 1 * bay - bay / 2, (v / storey) % 1 * storey
    blur = footprint
    wear = fractal(u * 0.3, v * 0.3, seed, 3)
    wall = np.asarray(params["colour"], np.float32)[:, None] * (0.72 + 0.5 * wear)
    wall = mix(wall, colour(0.62, 0.58, 0.5), stripe(v, storey, 0.22, blur))
    opening = within(x, -0.48, 0.48, blur) * within(y, 0.9, 2.5, blur)
    shutters = (
        within(np.abs(x), 0.5, 0.95, blur)
        * within(y, 0.9, 2.5, blur)
        * (scatter(column, axis, row, seed=seed + 1) < 0.7)
    )
    bars = np.maximum(within(x, -0.04, 0.04, blur), stripe(y - 0.9, 0.55, 0.06, blur))
    albedo = mix(
        wall, np.asarray(params["shutter"], np.float32), shutters * (0.75 + 0.25 * stripe(v, 0.16, 0.08, blur))
    )
    albedo = mix(albedo, mix(colour(0.05, 0.06, 0.08), colour(0.5, 0.48, 0.45), bars), opening)
    side = axis != 2
    albedo = np.where(side, albedo, colour(0.30, 0.16, 0.11)[:, None] * (0.7 + 0.6 * wear)).astype(np.float32)
    on = (scatter(column, row, axis, seed=seed + 2) < 0.38) & side
    glow = opening * (1 - bars) * on * (0.4 + 0.6 * scatter(row, column, seed=seed + 3))
    return Surface(albedo, wall_tilt(0 * u, 0 * v, axis), LAMPLIGHT[:, None] * glow * 0.8, 0.18 * opening * side)


def hill(point, normal, footprint, params):
    """A wooded hill in the haze."""
    woods = fractal(point[0] * 0.05, point[1] * 0.05 + point[2] * 0.1, 171, 4)
    return Surface(mix(colour(0.14, 0.17, 0.13), colour(0.24, 0.27, 0.24), woods))


def skin(point, normal, footprint, params):
    """One plain colour: skin, hair, bags, umbrellas' undersides."""
    base = np.asarray(params["colour"], np.float32)[:, None]
    return Surface(np.broadcast_to(base, point.shape).astype(np.float32))


def cloth(point, normal, footprint, params):
    """Clothes: plain, striped, checked or in gores, of `colour` and `other`."""
    first, second = np.asarray(params["colour"], np.float32), np.asarray(params["other"], np.float32)
    u, v = np.arctan2(point[1], point[0]) * 0.2, point[2]
    pattern = params["pattern"]
    if pattern == "stripes":
        share = stripe(v, 0.12, 0.06, footprint)
    elif pattern == "checks":
        share = 0.5 * stripe(v, 0.14, 0.07, footprint) + 0.5 * stripe(u, 0.14, 0.07, footprint)
    elif pattern == "gores":  # umbrellas and parasols
        share = ((np.arctan2(point[1], point[0]) * 4 / np.pi) % 2 < 1).astype(np.float32)
    else:
        share = np.zeros_like(u)
    folds = fractal(u * 25, v * 5, 181, 2)
    return Surface(mix(first, second, share) * (0.75 + 0.5 * folds))


def paint(point, normal, footprint, params):
    """A vehicle's body: windows and lights by height, in local metres of a body that runs along x."""
    base = np.asarray(params["colour"], np.float32)
    length, width, height = params["half"]
    albedo = np.broadcast_to(base[:, None], point.shape).astype(np.float32)
    side, front = np.abs(normal[1]) > 0.6, np.abs(normal[0]) > 0.6
    low, high = params["panes"]
    z = point[2]
    posts = stripe(point[0], params["pane"], 0.11, footprint) * side
    across = np.where(
        side,
        within(np.abs(point[0]), -1, length * 0.94, footprint),
        within(np.abs(point[1]), -1, width * 0.86, footprint),
    )
    pane = within(z, low, high, footprint) * (side | front) * across * (1 - posts)
    if "band" in params:
        albedo = mix(albedo, np.asarray(params["band"], np.float32), within(z, low - 0.55, low - 0.2, footprint))
    albedo = mix(albedo, colour(0.03, 0.035, 0.045), pane)
    spot = front * within(np.abs(point[1]), width * 0.55, width * 0.9, footprint)
    spot = spot * within(z, -height * 0.3, height * 0.1, footprint) * params.get("lights", 1.0)
    tone = np.where(point[0] > 0, colour(0.9, 0.88, 0.8)[:, None], colour(0.6, 0.05, 0.04)[:, None])
    gloss = 0.1 + 0.3 * pane
    return Surface(
        mix(albedo, tone, spot), None, tone * spot * 1.5 + LAMPLIGHT[:, None] * pane * params.get("inside", 0.0), gloss
    )


def tyre(point, normal, footprint, params):
    """A wheel: rubber round a hub."""
    hub = within(np.hypot(point[0], point[1]), -1, params["radius"] * 0.55, footprint) * (np.abs(normal[2]) > 0.5)
    return Surface(mix(colour(0.02, 0.02, 0.02), colour(0.42, 0.42, 0.43), hub))
