"""Value noise and repeated patterns, softened by the footprint of a sample so that far walls do not sparkle."""

import numpy as np


def scatter(*cells: np.ndarray, seed: int = 0) -> np.ndarray:
    """A number in [0, 1) for each cell of an integer lattice, the same wherever and whenever it is asked for."""
    mixed = np.array((seed * 0x9E3779B9 + 0x7F4A7C15) & 0xFFFFFFFF, np.uint32)
    for cell, prime in zip(cells, (0x85EBCA6B, 0xC2B2AE35, 0x27D4EB2F)):
        mixed = (mixed ^ (np.asarray(cell).astype(np.int64) & 0xFFFFFFFF).astype(np.uint32)) * np.uint32(prime)
        mixed = mixed ^ (mixed >> np.uint32(15))
    mixed = mixed * np.uint32(0x2C1B3C6D)
    return (mixed >> np.uint32(8)).astype(np.float32) / np.float32(1 << 24)


def value_noise(u: np.ndarray, v: np.ndarray, seed: int = 0) -> np.ndarray:
    """Smooth noise in [0, 1] over the plane, one lattice cell a unit."""
    iu, iv = np.floor(u), np.floor(v)
    fu, fv = u - iu, v - iv
    fu, fv = fu * fu * (3 - 2 * fu), fv * fv * (3 - 2 * fv)
    iu, iv = iu.astype(np.int64), iv.astype(np.int64)
    low = scatter(iu, iv, seed=seed) * (1 - fu) + scatter(iu + 1, iv, seed=seed) * fu
    high = scatter(iu, iv + 1, seed=seed) * (1 - fu) + scatter(iu + 1, iv + 1, seed=seed) * fu
    return (low * (1 - fv) + high * fv).astype(np.float32)


def fractal(u: np.ndarray, v: np.ndarray, seed: int = 0, octaves: int = 3) -> np.ndarray:
    """Octaves of value noise, in [0, 1]."""
    total, weight = np.zeros(np.shape(u), np.float32), 0.0
    for octave in range(octaves):
        share = 0.5**octave
        total += share * value_noise(u * 2.03**octave + 7.1 * octave, v * 2.03**octave - 3.7 * octave, seed + octave)
        weight += share
    return total / np.float32(weight)


def stripe(u: np.ndarray, period: float, width: float, footprint: np.ndarray) -> np.ndarray:
    """Coverage in [0, 1] by lines of `width` at multiples of `period`, box-filtered over `footprint`; all metres."""
    distance = np.abs((u / period + 0.5) % 1 - 0.5) * period
    blur = np.maximum(footprint, 1e-3)
    sharp = np.clip((width / 2 - distance) / blur + 0.5, 0, 1) * np.minimum(1, width / blur)
    # Where a sample spans whole periods, only the mean share is left.
    fade = np.clip(blur / period, 0, 1)
    return (sharp * (1 - fade) + fade * width / period).astype(np.float32)


def within(u: np.ndarray, low: float, high: float, footprint: np.ndarray) -> np.ndarray:
    """Coverage in [0, 1] of low < u < high."""
    blur = np.maximum(footprint, 1e-3)
    return (np.clip((u - low) / blur + 0.5, 0, 1) * np.clip((high - u) / blur + 0.5, 0, 1)).astype(np.float32)


def mix(first: np.ndarray, second: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Colours (3,) or (3, N) blended by share (N,)."""
    first, second = (c[:, None] if np.ndim(c) == 1 else c for c in (np.asarray(first), np.asarray(second)))
    return (first * (1 - share) + second * share).astype(np.float32)
