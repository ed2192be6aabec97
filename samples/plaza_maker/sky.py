"""The sky of a look: gradient, glow, clouds, stars."""

import numpy as np

from samples.plaza_maker.looks import Look
from samples.plaza_maker.noise import fractal, mix, scatter
from samples.plaza_maker.surface import colour


def gradient(look: Look, directions: np.ndarray) -> np.ndarray:
    """Radiance (3, N) of the sky without clouds or sun disc; below the horizon that of the horizon."""
    height = np.clip(directions[2], 0, 1) ** look.gradient
    radiance = mix(colour(*look.horizon), colour(*look.zenith), height)
    toward = np.clip(np.asarray(look.sun_direction, np.float32) @ directions, 0, 1)
    wide = toward**3 * (1 - np.clip(directions[2], 0, 1)) * 0.8 + toward**24 * 0.7
    return radiance + colour(*look.glow)[:, None] * wide


def _cloud_cover(look: Look, directions: np.ndarray, lift: float = 0.0) -> np.ndarray:
    """Density of clouds in [0, 1] on a flat layer; `lift` moves the look-up towards the sun, for self-shading."""
    sun = look.sun_direction
    flat = 1 / (np.clip(directions[2], 0, 1) + 0.12)
    u = directions[0] * flat * look.cloud_scale + look.cloud_offset + lift * sun[0]
    v = directions[1] * flat * look.cloud_scale - 0.4 * look.cloud_offset + lift * sun[1]
    density = fractal(u, v, look.seed % 9973, 5)
    low = 0.78 - 0.56 * look.clouds
    return np.clip((density - low) / 0.20, 0, 1)


def sky(look: Look, directions: np.ndarray) -> np.ndarray:
    """Radiance (3, N) seen in world directions (3, N)."""
    radiance = gradient(look, directions)
    toward = np.asarray(look.sun_direction, np.float32) @ directions
    if look.stars:
        cells = np.floor(directions * 240).astype(np.int64)
        star = (scatter(*cells, seed=3) > 0.9985) & (directions[2] > 0.05)
        radiance = radiance + star * (0.10 * scatter(*cells, seed=4))
    if look.disc:
        radiance = radiance + colour(*look.sun)[:, None] * (np.clip((toward - 0.9988) / 0.0006, 0, 1) * look.disc)
    if look.clouds > 0:
        cover = _cloud_cover(look, directions)
        thick = _cloud_cover(look, directions, 0.22)
        bright = np.clip(1.05 - 0.75 * thick, 0, 1) + 0.6 * np.clip(toward, 0, 1) ** 8 * (1 - thick)
        cloud = mix(colour(*look.cloud_shade), colour(*look.cloud_light), np.clip(bright, 0, 1.4))
        fade = np.clip(directions[2] * 7 + 0.25, 0, 1)
        radiance = mix(radiance, cloud, cover * fade * look.cloud_opacity)
    return radiance.astype(np.float32)


def ambient(look: Look, directions: np.ndarray) -> np.ndarray:
    """The sky as a light: like `sky`, clouds averaged, no disc."""
    clouds = 0.5 * colour(*look.cloud_shade) + 0.5 * colour(*look.cloud_light)
    return mix(
        gradient(look, directions),
        clouds,
        np.full(directions.shape[1], 0.75 * look.clouds * look.cloud_opacity, np.float32),
    )
