"""Figures on how photos of the same points differ:
by look, by exposure alone, by where they were taken from, by who stood there.

What neighbouring points of a photo share is look; what each has for itself is noise (texture, features a pixel off) and
averages out of the product of neighbours, as the nugget does from a variogram (Matheron 1963). Nothing is learned.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.run.sized_photo import SizedPhoto
from core.training.sightings import FEWEST_PHOTOS, NEAR_DEGREES, Sightings, find_sightings, neighbours, rows_of_each

FEWEST_SIGHTINGS = 600
FEWEST_IN_PHOTO = 40  # matches, against the 6 unknowns of its exposure
ROUNDS = 4  # of exposures and base colours in turn; the figures move by less than 2 % after the third
CLIP = 4.0  # medians; larger differences count as this large, so that wrong matches do not decide
EXPOSURE_PRIOR = 0.4  # sightings' worth of belief in gain 1 and offset 0: against extrapolating from a few alike
FEWEST_VIEWS = 7  # of a point, for the 4 unknowns of a colour linear in the viewing direction
FEWEST_OF_MANY_VIEWS = 300  # sightings of such points
CLOSEST = 1000  # expected or matched places looked at for passers-by: those seen again from nearest by
FEWEST_CLOSEST = 300
STRANGE_MEDIANS, STRANGE_STEPS = 4.0, 20.0  # of its photo; 8-bit steps: a place is strange if off by more than both
STEPS = 255.0


@dataclass(frozen=True)
class Evidence:
    """What the photos say, of which there are `photos`; None where they say too little.

    colour_spread: of a point over the photos, 8-bit steps. spread_beyond_exposure: the same after a gain and an offset
    for each photo and channel, its exposure. view_dependence: share, up to 1, of the latter that the viewing direction
    explains. strange_share: of places, those that look unlike what photos from nearly the same place show.
    """

    photos: int
    colour_spread: float | None = None
    spread_beyond_exposure: float | None = None
    view_dependence: float | None = None
    strange_share: float | None = None


def gather_evidence(points: np.ndarray, photos: Sequence[SizedPhoto]) -> Evidence:
    """The figures of a collection: SfM points (P, 3; scene frame) and its decoded training photos."""
    sightings = _judgeable(find_sightings(points, photos))
    matched = sightings[sightings.matched]
    if len(matched) < FEWEST_SIGHTINGS or len(np.unique(matched.photo)) < FEWEST_PHOTOS:
        return Evidence(len(photos))
    base, exposures = fit_exposures(matched)
    pairs = neighbours(matched)
    left = matched.colour - exposed(exposures, matched.photo, base[matched.point])
    expected = exposed(exposures, sightings.photo, base[sightings.point])
    return Evidence(
        len(photos),
        colour_spread=shared_spread(matched, pairs, matched.colour - _mean_colours(matched)[matched.point]),
        spread_beyond_exposure=shared_spread(matched, pairs, left),
        view_dependence=view_dependence(matched, left),
        strange_share=strange_share(sightings, sightings.colour - expected),
    )


def _judgeable(sightings: Sightings) -> Sightings:
    """The places in photos with enough matches for an exposure, of points that two such photos matched,
    without photos that then have no match."""
    for kind, fewest in (("photo", FEWEST_IN_PHOTO), ("point", 2), ("photo", 1)):
        numbers = getattr(sightings, kind)
        counts = np.bincount(numbers, weights=sightings.matched)
        sightings = sightings[counts[numbers] >= fewest]
    return sightings


# --- exposures: colour = gain * base + offset, for each photo and channel


def fit_exposures(sightings: Sightings) -> tuple[np.ndarray, np.ndarray]:
    """(base, exposures): base colours (P, 3) of the points, gain and offset (K, 2, 3) of the photos.

    Least squares of one and the other in turn, with Huber's weights.
    """
    base = _mean_colours(sightings)
    for _ in range(ROUNDS):
        exposures = exposures_of(sightings.photo, base[sightings.point], sightings.colour)
        gain, offset = exposures[sightings.photo, 0], exposures[sightings.photo, 1]
        weight = _huber(sightings.colour - gain * base[sightings.point] - offset)
        above = _sums(sightings.point, weight * gain * (sightings.colour - offset))
        below = _sums(sightings.point, weight * gain**2)
        base = above / np.maximum(below, 1e-9)
    return base, exposures_of(sightings.photo, base[sightings.point], sightings.colour)


def exposures_of(group: np.ndarray, base: np.ndarray, colour: np.ndarray) -> np.ndarray:
    """Gain and offset (G, 2, 3) that lead from base colours (N, 3) to colours (N, 3),
    in each group (N,) of sightings."""
    weight = np.ones((len(group), 1))
    for _ in range(ROUNDS):
        ones = _sums(group, weight) + EXPOSURE_PRIOR
        x, y = _sums(group, weight * base), _sums(group, weight * colour)
        xx = _sums(group, weight * base**2) + EXPOSURE_PRIOR
        xy = _sums(group, weight * base * colour) + EXPOSURE_PRIOR
        gain = (ones * xy - x * y) / (ones * xx - x**2)  # Cauchy-Schwarz and the prior keep the divisor above 0
        exposures = np.stack([gain, (y - gain * x) / ones], axis=1)
        weight = _huber(colour - exposed(exposures, group, base))
    return exposures


def exposed(exposures: np.ndarray, group: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Base colours (N, 3) in the exposure of their groups (N,)."""
    return exposures[group, 0] * base + exposures[group, 1]


# --- figures


def shared_spread(sightings: Sightings, pairs: tuple[np.ndarray, np.ndarray], difference: np.ndarray) -> float:
    """Root mean product of the differences (N, 3) of neighbouring sightings,
    8-bit steps per channel: what they share. pairs: their `neighbours`."""
    first, second = pairs
    counts = np.bincount(sightings.point)[sightings.point]
    # A base colour is the mean of n sightings and hides 1/n of their variance.
    clipped = _clipped(difference) * np.sqrt(counts / np.maximum(counts - 1, 1))[:, None]
    shared = float((clipped[first] * clipped[second]).mean()) if len(first) else 0.0
    return STEPS * max(shared, 0.0) ** 0.5


def view_dependence(sightings: Sightings, difference: np.ndarray) -> float | None:
    """The share of the differences (N, 3) that a colour linear in the viewing direction explains, chance taken off.

    Over the points with FEWEST_VIEWS; None if there are not FEWEST_OF_MANY_VIEWS sightings of such points. SS_explained
    minus what as many random regressors would explain, as in the adjusted coefficient of determination.
    """
    enough = np.bincount(sightings.point)[sightings.point] >= FEWEST_VIEWS
    if enough.sum() < FEWEST_OF_MANY_VIEWS:
        return None
    sightings, clipped = sightings[enough], _clipped(difference[enough])
    explained = total = 0.0
    for rows in rows_of_each(sightings.point):
        values = clipped[rows] - clipped[rows].mean(axis=0)
        directions = sightings.towards[rows] - sightings.towards[rows].mean(axis=0)
        basis = np.linalg.svd(directions, full_matrices=False)[0]
        whole = float((values**2).sum())
        fitted = float(((basis.T @ values) ** 2).sum())
        explained += fitted - 3 * (whole - fitted) / (len(rows) - 4)
        total += whole
    return max(explained / total, 0.0) if total else 0.0


def strange_share(sightings: Sightings, difference: np.ndarray) -> float | None:
    """The share of the CLOSEST places that look strange (STRANGE_MEDIANS) together with their neighbour.

    A point hidden by what stays is hidden from nearby too, the more surely the nearer; one hidden by a passer-by is
    not. So the places that another photo matched from nearest by tell the two apart. None if there are too few.
    """
    size = np.linalg.norm(difference, axis=1) * STEPS / np.sqrt(3)
    usual = np.full(int(sightings.photo.max()) + 1, np.inf)
    for rows in rows_of_each(sightings.photo):
        usual[sightings.photo[rows[0]]] = np.median(size[rows][sightings.matched[rows]])
    strange = size > np.maximum(STRANGE_STEPS, STRANGE_MEDIANS * usual[sightings.photo])
    together = np.zeros(len(sightings), dtype=bool)
    first, second = neighbours(sightings)
    together[first] = strange[first] & strange[second]
    near = np.flatnonzero(sightings.degrees <= NEAR_DEGREES)
    if len(near) < FEWEST_CLOSEST:
        return None
    return float(together[near[np.argsort(sightings.degrees[near], kind="stable")[:CLOSEST]]].mean())


# --- small sums


def _sums(group: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sums (G, C) of the values (N, C) of each group (N,)."""
    return np.stack([np.bincount(group, weights=column) for column in values.T], axis=1)


def _mean_colours(sightings: Sightings) -> np.ndarray:
    """(P, 3): the mean colour of each point, 0 for one without sightings."""
    return _sums(sightings.point, sightings.colour) / np.maximum(np.bincount(sightings.point), 1)[:, None]


def _huber(difference: np.ndarray) -> np.ndarray:
    """Huber's weights (N, 1) of differences (N, 3): 1 up to one and a half medians, falling beyond."""
    size = np.linalg.norm(difference, axis=1, keepdims=True)
    return 1 / np.maximum(size / max(1.5 * float(np.median(size)), 1e-3), 1)


def _clipped(difference: np.ndarray) -> np.ndarray:
    """The differences (N, 3), none longer than CLIP medians."""
    size = np.linalg.norm(difference, axis=1, keepdims=True)
    return difference / np.maximum(size / max(CLIP * float(np.median(size)), 1e-9), 1)
