"""Convex solids, and where a ray enters and leaves them.

Arrays of points and directions are (3, N) float32 throughout. World axes: x right, y away from the front, z up; metres.
"""

from dataclasses import dataclass, field

import numpy as np

MISS = np.float32(1e9)  # metres; farther than anything in the scene


@dataclass(frozen=True)
class Solid:
    """A convex solid, minus convex holes.

    kind: "box" (half sizes `size`), "sphere" (ellipsoid with radii `size`), "frustum" (radii size[0], size[1] at
    z = -size[2], scaled by `taper` at z = +size[2]), "prism" (triangle: base 2 size[0] at z = 0, apex at z = size[2],
    length 2 size[1] along y), "arch" (box of half width size[0], length 2 size[1] along y, z from 0 to size[2], under a
    half round of radius size[0]; the usual hole of a wall).
    rotation: (3, 3) world to local; centre: (3,) world position of the local origin.
    material: a name in materials.MATERIALS with its parameters. holes: in world coordinates.
    """

    kind: str
    centre: np.ndarray
    size: np.ndarray
    rotation: np.ndarray
    material: str
    params: dict = field(default_factory=dict)
    taper: float = 1.0
    holes: tuple["Solid", ...] = ()

    @property
    def bound(self) -> tuple[np.ndarray, float]:
        """Centre and radius of a sphere around the solid."""
        x, y, z = self.size
        if self.kind == "sphere":
            return self.centre, float(max(x, y, z))
        if self.kind == "frustum":
            widest = max(x, y) * max(1.0, self.taper)
            return self.centre, float(np.hypot(widest, z))
        if self.kind in ("prism", "arch"):
            top = z + (x if self.kind == "arch" else 0.0)
            return self.centre + self.rotation.T @ [0, 0, top / 2], float(np.sqrt(x * x + y * y + top * top / 4))
        return self.centre, float(np.sqrt(x * x + y * y + z * z))

    def to_local(self, points: np.ndarray) -> np.ndarray:
        """World points (3, N) in the solid's own metres."""
        return (self.rotation @ (points - self.centre[:, None])).astype(np.float32)


def make(kind, centre, size, material, yaw=0.0, rotation=None, taper=1.0, holes=(), **params) -> Solid:
    """A solid turned by `yaw` (degrees about z), or by a world-to-local `rotation`."""
    if rotation is None:
        angle = np.radians(yaw)
        c, s = np.cos(angle), np.sin(angle)
        rotation = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return Solid(
        kind,
        np.asarray(centre, float),
        np.asarray(size, float),
        np.asarray(rotation, float),
        material,
        params,
        taper,
        tuple(holes),
    )


def limb(start, end, start_radius, end_radius, material, **params) -> Solid:
    """A frustum from one point to another: arms, legs, trunks, poles."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    axis = end - start
    length = np.linalg.norm(axis)
    axis = axis / length
    side = np.cross(axis, [1.0, 0, 0] if abs(axis[0]) < 0.8 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    rotation = np.stack([side, np.cross(axis, side), axis])
    size = (start_radius, start_radius, length / 2)
    return make(
        "frustum", (start + end) / 2, size, material, rotation=rotation, taper=end_radius / start_radius, **params
    )


def _slabs(origin, inverse, low, high):
    """Entry and exit of axis-aligned bounds low..high, each (3,)."""
    first = (low[:, None] - origin) * inverse
    second = (high[:, None] - origin) * inverse
    return np.minimum(first, second).max(axis=0), np.maximum(first, second).min(axis=0)


def _quadric(a, b, c):
    """Roots of a t^2 + 2 b t + c with a > 0, as an interval; empty (entry > exit) where there are none."""
    disc = b * b - a * c
    root = np.sqrt(np.maximum(disc, 0))
    enter, leave = (-b - root) / a, (-b + root) / a
    return np.where(disc < 0, MISS, enter), np.where(disc < 0, -MISS, leave)


def _safe(direction):
    """The direction with no component so near zero that its inverse overflows."""
    return np.where(np.abs(direction) < 1e-7, np.float32(1e-7), direction)


def _frustum_interval(solid, o, d):
    """A cone's inside is two nappes; of these only the one of positive radius counts."""
    half = np.float32(solid.size[2])
    squash = np.float32(solid.size[0] / solid.size[1])
    middle = np.float32(solid.size[0] * (1 + solid.taper) / 2)
    slope = np.float32(solid.size[0] * (solid.taper - 1) / 2 / half)
    ox, oy, dx, dy = o[0], o[1] * squash, d[0], d[1] * squash
    radius, change = middle + slope * o[2], slope * d[2]
    a = dx * dx + dy * dy - change * change
    b = ox * dx + oy * dy - radius * change
    c = ox * ox + oy * oy - radius * radius
    a = np.where(np.abs(a) < 1e-9, np.float32(1e-9), a)
    disc = b * b - a * c
    root = np.sqrt(np.maximum(disc, 0))
    first, second = (-b - root) / a, (-b + root) / a
    low, high = np.minimum(first, second), np.maximum(first, second)
    steep, missed = a < 0, disc < 0
    widening = change > 0
    enter = np.where(steep, np.where(missed | ~widening, -MISS, high), np.where(missed, MISS, low))
    leave = np.where(steep, np.where(missed | widening, MISS, low), np.where(missed, -MISS, high))
    inverse = 1 / d[2]
    near, far = (-half - o[2]) * inverse, (half - o[2]) * inverse
    return np.maximum(enter, np.minimum(near, far)), np.minimum(leave, np.maximum(near, far))


def _prism_interval(solid, o, d):
    half, length, height = (np.float32(v) for v in solid.size)
    enter, leave = _slabs(
        o, 1 / d, np.array([-half, -length, 0], np.float32), np.array([half, length, height], np.float32)
    )
    for sign in (-1, 1):  # the two roof planes: sign * x * height + z * half <= half * height
        speed = sign * d[0] * height + d[2] * half
        distance = half * height - (sign * o[0] * height + o[2] * half)
        speed = np.where(np.abs(speed) < 1e-7, np.float32(1e-7), speed)
        t = distance / speed
        enter = np.where(speed < 0, np.maximum(enter, t), enter)
        leave = np.where(speed > 0, np.minimum(leave, t), leave)
    return enter, leave


def _arch_interval(solid, o, d):
    half, length, height = (np.float32(v) for v in solid.size)
    inverse = 1 / d
    low, high = np.array([-half, -length, 0], np.float32), np.array([half, length, height], np.float32)
    enter, leave = _slabs(o, inverse, low, high)
    rise = o[2] - height
    round_enter, round_leave = _quadric(
        d[0] * d[0] + d[2] * d[2], o[0] * d[0] + rise * d[2], o[0] * o[0] + rise * rise - half * half
    )
    first, second = (-length - o[1]) * inverse[1], (length - o[1]) * inverse[1]
    round_enter = np.maximum(round_enter, np.minimum(first, second))
    round_leave = np.minimum(round_leave, np.maximum(first, second))
    boxed, rounded = enter <= leave, round_enter <= round_leave
    # The union of the two is convex, so its interval runs from the earlier entry to the later exit.
    enter, leave = np.where(boxed, enter, MISS), np.where(boxed, leave, -MISS)
    return (
        np.where(rounded, np.minimum(enter, round_enter), enter),
        np.where(rounded, np.maximum(leave, round_leave), leave),
    )


def interval(solid: Solid, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances at which rays enter and leave a solid, ignoring its holes; entry > exit where they miss it."""
    o = solid.to_local(origins)
    d = _safe((solid.rotation @ directions).astype(np.float32))
    if solid.kind == "box":
        half = solid.size.astype(np.float32)
        return _slabs(o, 1 / d, -half, half)
    if solid.kind == "sphere":
        scale = (1 / solid.size).astype(np.float32)[:, None]
        o, d = o * scale, d * scale
        return _quadric((d * d).sum(0), (o * d).sum(0), (o * o).sum(0) - 1)
    return {"frustum": _frustum_interval, "prism": _prism_interval, "arch": _arch_interval}[solid.kind](solid, o, d)


def first_hit(solid: Solid, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance to the first surface in front of each ray (MISS where none), and the hole it lies in (-1 = none)."""
    enter, leave = interval(solid, origins, directions)
    t = np.maximum(enter, 0)
    inside = np.full(t.shape, -1, np.int16)
    spans = [interval(hole, origins, directions) for hole in solid.holes]
    for _ in range(2 if len(spans) > 1 else 1):  # two passes settle the crossing holes of a belfry
        for number, (hole_enter, hole_leave) in enumerate(spans):
            through = (hole_enter <= t + 1e-4) & (hole_leave > t)
            t = np.where(through, hole_leave, t)
            inside[through] = number
    hit = (t < leave - 1e-5) & (enter < leave) & ((enter > 0) | (inside >= 0))
    return np.where(hit, t, MISS).astype(np.float32), inside


def normals(solid: Solid, local: np.ndarray) -> np.ndarray:
    """Outward local normals (3, N) at surface points given in local metres."""
    size = solid.size.astype(np.float32)
    result = np.zeros_like(local)
    columns = np.arange(local.shape[1])
    if solid.kind == "box":
        axis = (np.abs(local) - size[:, None]).argmax(axis=0)
        result[axis, columns] = np.sign(local[axis, columns])
        return result
    if solid.kind == "sphere":
        result = local / (size**2)[:, None]
        return result / np.maximum(np.linalg.norm(result, axis=0), 1e-9)
    if solid.kind == "frustum":
        slope = (solid.taper - 1) / 2 * size[0] / size[2]
        middle = size[0] * (1 + solid.taper) / 2
        radial = np.hypot(local[0], local[1] * size[0] / size[1])
        flank = np.abs(radial - (middle + slope * local[2]))
        cap = np.abs(np.abs(local[2]) - size[2])
        side = np.stack([local[0], local[1] * (size[0] / size[1]) ** 2, -slope * np.maximum(radial, 1e-6)])
        side /= np.maximum(np.linalg.norm(side, axis=0), 1e-9)
        result[2] = np.sign(local[2])
        return np.where(cap < flank, result, side)
    if solid.kind == "prism":
        lean = np.hypot(size[0], size[2])
        planes = np.array(
            [
                [size[2] / lean, 0, size[0] / lean],
                [-size[2] / lean, 0, size[0] / lean],
                [0, 1, 0],
                [0, -1, 0],
                [0, 0, -1],
            ],
            np.float32,
        )
        offsets = np.array([size[0] * size[2] / lean] * 2 + [size[1]] * 2 + [0], np.float32)
        return planes[(planes @ local - offsets[:, None]).argmax(axis=0)].T.copy()
    above = local[2] > size[2]
    rise = np.where(above, local[2] - size[2], 0)
    distances = np.stack([np.hypot(local[0], rise) - size[0], np.abs(local[1]) - size[1], -local[2]])
    axis = distances.argmax(axis=0)
    radial = np.stack([local[0], np.zeros_like(rise), rise])
    radial /= np.maximum(np.linalg.norm(radial, axis=0), 1e-9)
    ends = np.stack([np.zeros_like(rise), np.sign(local[1]), np.zeros_like(rise)])
    floor = np.stack([np.zeros_like(rise), np.zeros_like(rise), -np.ones_like(rise)])
    return np.where(axis == 0, radial, np.where(axis == 1, ends, floor))
