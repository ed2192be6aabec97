"""Looks: the weather, the hour and the camera's settings of one photo."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from samples.plaza_maker.surface import colour


@dataclass(frozen=True)
class Look:
    """Everything that decides how a photo looks, apart from where it was taken and who is in it.

    Colours are RGB radiance, in units in which a white wall square to the midday sun is about 1. sun_direction: world
    (z up), towards the sun; sun_width: the radius of its disc as a light, radians; disc: how much brighter than `sun`
    it is drawn, 0 if it is hidden; glow: colour of the sky around it. gradient: exponent of the sky's fade from horizon
    to zenith. clouds: cover in [0, 1]. haze: extinction, 1 / metre. lamps: 0 by day, 1 by night. exposure multiplies
    radiance; balance is the white balance's gains; gamma, contrast, saturation and lift make the tone curve; vignette
    is the loss in the corners; grain the noise (8-bit steps); quality the JPEG's. seed: of the grain, and of the
    clouds' shapes.
    """

    kind: str
    seed: int
    sun_direction: tuple
    sun: tuple
    sun_width: float
    zenith: tuple
    horizon: tuple
    gradient: float
    glow: tuple
    disc: float
    clouds: float
    cloud_scale: float
    cloud_offset: float
    cloud_light: tuple
    cloud_shade: tuple
    cloud_opacity: float
    stars: bool
    haze: float
    lamps: float
    exposure: float
    balance: tuple
    gamma: float
    contrast: float
    saturation: float
    lift: float
    vignette: float
    grain: float
    quality: int


def _toward(azimuth: float, elevation: float) -> tuple:
    """Unit vector towards azimuth (0 = in front of the church, that is -y; 90 = right) and elevation, in degrees."""
    a, e = np.radians(azimuth), np.radians(elevation)
    return (float(np.sin(a) * np.cos(e)), float(-np.cos(a) * np.cos(e)), float(np.sin(e)))


class _Weather(NamedTuple):
    """What looks of a kind are drawn from: ranges of the sun's azimuth and elevation (degrees) and of cloud cover;
    colours of sun, zenith and horizon; strength of the glow round the sun; lamps; exposure."""

    azimuths: tuple
    elevations: tuple
    sun: tuple
    zenith: tuple
    horizon: tuple
    glow: float
    clouds: tuple
    lamps: float
    exposure: float


_WEATHER = {
    "noon": _Weather(
        (-75, 75), (40, 60), (1.30, 1.21, 1.05), (0.06, 0.15, 0.38), (0.26, 0.35, 0.46), 0.10, (0.0, 0.35), 0, 1.00
    ),
    "morning": _Weather(
        (30, 115), (14, 32), (1.25, 0.98, 0.66), (0.07, 0.14, 0.31), (0.32, 0.32, 0.32), 0.20, (0.0, 0.4), 0, 1.05
    ),
    "afternoon": _Weather(
        (-115, -30), (18, 40), (1.30, 1.06, 0.76), (0.06, 0.14, 0.34), (0.29, 0.33, 0.38), 0.18, (0.0, 0.45), 0, 1.00
    ),
    "cloudy": _Weather(
        (-110, 110), (25, 55), (0.95, 0.90, 0.80), (0.10, 0.20, 0.40), (0.34, 0.39, 0.46), 0.1, (0.5, 0.72), 0, 1.0
    ),
    "overcast": _Weather(
        (-110, 110), (35, 60), (0.03, 0.03, 0.03), (0.42, 0.44, 0.47), (0.50, 0.51, 0.53), 0.0, (0.85, 1.0), 0, 1.25
    ),
    "sunset": _Weather(
        (-115, -25), (4, 11), (1.15, 0.52, 0.18), (0.06, 0.11, 0.26), (0.62, 0.33, 0.17), 0.55, (0.1, 0.55), 0.25, 1.5
    ),
    "dusk": _Weather(
        (-150, 150), (-4, 0), (0.0, 0.0, 0.0), (0.02, 0.035, 0.11), (0.16, 0.085, 0.09), 0.22, (0.0, 0.6), 0.8, 2.3
    ),
    "night": _Weather(
        (-180, 180),
        (25, 60),
        (0.006, 0.007, 0.010),
        (0.004, 0.006, 0.016),
        (0.022, 0.016, 0.014),
        0.0,
        (0.0, 0.5),
        1.0,
        2.3,
    ),
}
KINDS = tuple(_WEATHER)
WEATHER_EXPOSURE = {kind: weather.exposure for kind, weather in _WEATHER.items()}  # before each photo's own share


def draw_look(kind: str, rng: np.random.Generator, clouds: float | None = None) -> Look:
    """A look of a kind, drawn at random. clouds: their cover, also drawn by default."""
    weather = _WEATHER[kind]
    clouds = rng.uniform(*weather.clouds) if clouds is None else clouds
    direction = _toward(rng.uniform(*weather.azimuths), rng.uniform(*weather.elevations))
    usual = weather.sun, weather.zenith, weather.horizon
    sun, zenith, horizon = (np.array(colour) * rng.uniform(0.85, 1.15, 3) * rng.uniform(0.85, 1.15) for colour in usual)
    grey = 0.55 * sun + 0.35 * (zenith + horizon)
    if kind == "overcast":
        light, shade = horizon * rng.uniform(1.0, 1.25), horizon * rng.uniform(0.55, 0.8)
    elif kind in ("dusk", "night"):
        light, shade = horizon * 1.1, 0.6 * zenith + 0.25 * horizon
    elif kind == "sunset":
        light, shade = np.array([0.95, 0.45, 0.25]) * rng.uniform(0.8, 1.1), np.array([0.20, 0.15, 0.22])
    else:
        light, shade = grey * 0.85 + 0.12, 0.45 * grey * [0.9, 0.97, 1.08]
    warm = rng.normal(0, 0.10)  # white balance: most of its spread lies between amber and blue
    tint = rng.normal(0, 0.035)
    night = kind in ("dusk", "night")
    return Look(
        kind=kind,
        seed=int(rng.integers(1, 1 << 30)),
        sun_direction=direction,
        sun=tuple(map(float, sun)),
        sun_width=float(rng.uniform(0.006, 0.012)) if clouds < 0.5 else 0.05,
        zenith=tuple(map(float, zenith)),
        horizon=tuple(map(float, horizon)),
        gradient=float(rng.uniform(0.42, 0.65)),
        glow=tuple(float(weather.glow * c) for c in (1.0, 0.62, 0.30)),
        disc=0.0 if clouds > 0.6 or night else 3.0,
        clouds=float(clouds),
        cloud_scale=float(rng.uniform(0.8, 1.9)),
        cloud_offset=float(rng.uniform(0, 50)),
        cloud_light=tuple(map(float, light)),
        cloud_shade=tuple(map(float, shade)),
        cloud_opacity=0.8 if night else 0.95,
        stars=kind == "night" and clouds < 0.4,
        haze=float(rng.uniform(0.0004, 0.0028) * (1.7 if kind == "overcast" else 1.0)),
        lamps=float(weather.lamps),
        exposure=float(weather.exposure * 2 ** rng.normal(0, 0.33)),
        balance=(float(np.exp(warm)), float(np.exp(tint)), float(np.exp(-warm * 1.3))),
        gamma=float(rng.uniform(0.86, 1.14)),
        contrast=float(rng.uniform(0.0, 0.9)),
        saturation=float(rng.choice([rng.uniform(0.45, 0.8), rng.uniform(0.9, 1.45)], p=[0.2, 0.8])),
        lift=float(rng.choice([0.0, rng.uniform(0.01, 0.06)])),
        vignette=float(rng.uniform(0.0, 0.35)),
        grain=float(rng.uniform(0.8, 2.2) * (1.8 if night else 1.0)),
        quality=int(rng.integers(80, 88)),
    )


def develop(look: Look, radiance: np.ndarray) -> np.ndarray:
    """Linear radiance (H, W, 3) to the photo's values in [0, 1], without grain."""
    height, width = radiance.shape[:2]
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    reach = np.hypot(width, height) / 2
    corner = ((x + 0.5 - width / 2) ** 2 + (y + 0.5 - height / 2) ** 2) / reach**2
    light = radiance * look.exposure * (1 - look.vignette * corner)[..., None] * colour(*look.balance)
    # Reinhard's curve, white at about 2.6, its foot made steeper.
    filmed = light * (1 + light / 2.6**2) / (1 + light * 0.55)
    value = np.clip(filmed, 0, 1) ** (1 / (2.2 * look.gamma))
    smooth = value * value * (3 - 2 * value)
    value = value + look.contrast * (smooth - value)
    grey = value @ colour(0.30, 0.59, 0.11)
    value = grey[..., None] + look.saturation * (value - grey[..., None])
    return np.clip(look.lift + (1 - look.lift) * value, 0, 1).astype(np.float32)


def to_bytes(value: np.ndarray, look: Look | None = None) -> np.ndarray:
    """[0, 1] to 8 bits, with the look's grain where one is given."""
    if look is not None:
        value = value + np.random.default_rng(look.seed).normal(0, look.grain / 255, value.shape)
    return np.clip(np.rint(value * 255), 0, 255).astype(np.uint8)
