"""The colours in which photos show the SfM points: what is known about looks before anything is learned."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from core.data.collection import spread_over
from core.run.sized_photo import SizedPhoto

MOST_PHOTOS, MOST_POINTS = 200, 5000  # spread evenly over the collection; beyond, figures hardly change and seconds do
FEWEST_PHOTOS = 3  # that must have matched a point: of two photos that disagree none is right
BLUR = 0.003  # of the picture's diagonal: wider than features are off, so that texture does not count as a look
BLURRED_PIXELS = 250_000  # to so many, a larger photo is shrunk first: at 2 megapixels its blur takes 0.2 s
NEAREST = 16  # among so many most sightings have a neighbour, but not where a small subject has all the points
ROWS_AT_ONCE = 256  # of those without one that are compared with all others
EDGE = 2 * BLUR  # of the diagonal: nearer to the border the blur invents what it averages
NEAR_DEGREES = 10.0  # at most this far from a photo that matched it, a point should be seen as well
NEAR_DISTANCE = 1.5  # and at most this many times as far away, or as near
# A point is hidden by one around it at a smaller share of its depth.
FRONT_SHARE, FRONT_POINTS, FRONT_RADIUS = 0.93, 8, 0.03


@dataclass(frozen=True)
class Sightings:
    """N places in photos where a point is shown, or should be.

    photo, point: (N,) numbers from 0. pixel: (N, 2) in shares of the picture's diagonal. colour: (N, 3) in [0, 1],
    averaged over BLUR. towards: (N, 3) unit vector from the camera to the point. matched: (N,) whether the photo's
    features were matched to it; else it is expected there. degrees: (N,) angle at the point to the nearest other photo
    that matched it.
    """

    photo: np.ndarray
    point: np.ndarray
    pixel: np.ndarray
    colour: np.ndarray
    towards: np.ndarray
    matched: np.ndarray
    degrees: np.ndarray

    def __len__(self) -> int:
        return len(self.photo)

    def __getitem__(self, rows: np.ndarray) -> "Sightings":
        """Those selected by a mask or an index array."""
        return Sightings(**{name: values[rows] for name, values in vars(self).items()})


def find_sightings(points: np.ndarray, photos: Sequence[SizedPhoto]) -> Sightings:
    """Where the photos show the points (P, 3; scene frame) that FEWEST_PHOTOS of them matched.

    Expected are points that a photo did not match though one from nearly the same place did: a passer-by may stand
    before them. Those with other points close by in front are left out: what hides them may be part of the place.
    """
    photos = spread_over(photos, MOST_PHOTOS)
    chosen, matched = _matches(len(points), photos)
    positions = points[chosen]
    centres = np.array([sized.camera.centre for sized in photos]).reshape(-1, 3)
    rays = positions[:, None] - centres
    distances = np.linalg.norm(rays, axis=2)
    rays /= np.maximum(distances, 1e-12)[..., None]
    degrees = _degrees_to_nearest(rays, distances, matched)
    parts = [
        _in_photo(number, sized, positions, rays[:, number], matched[:, number], degrees[:, number])
        for number, sized in enumerate(photos)
    ]
    return Sightings(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])})


def neighbours(sightings: Sightings) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of rows (first, second):
    for each sighting the nearest one in the same photo whose blur does not touch its own."""
    first, second = [], []
    for rows in rows_of_each(sightings.photo):
        pixels = sightings.pixel[rows]
        distances, nearest = cKDTree(pixels).query(pixels, k=range(1, min(NEAREST, len(rows)) + 1))
        apart = distances >= 4 * BLUR
        there, partner = apart.any(axis=1), nearest[np.arange(len(rows)), apart.argmax(axis=1)]
        left = np.flatnonzero(~there)
        for part in np.split(left, range(ROWS_AT_ONCE, len(left), ROWS_AT_ONCE)):
            distances = cdist(pixels[part], pixels)
            distances[distances < 4 * BLUR] = np.inf
            there[part], partner[part] = np.isfinite(distances.min(axis=1)), distances.argmin(axis=1)
        first.append(rows[there])
        second.append(rows[partner[there]])
    return np.concatenate(first), np.concatenate(second)


def rows_of_each(numbers: np.ndarray) -> list[np.ndarray]:
    """The rows that share a number (photo, point), for each number that occurs."""
    order = np.argsort(numbers, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(numbers[order])) + 1)


def _matches(count: int, photos: Sequence[SizedPhoto]) -> tuple[np.ndarray, np.ndarray]:
    """The indices (P,) of the points that FEWEST_PHOTOS photos matched, and which photo matched which, (P, K)."""
    counts = np.zeros(count, dtype=np.int64)
    for sized in photos:
        counts[sized.photo.points] += 1
    chosen = np.array(spread_over(np.flatnonzero(counts >= FEWEST_PHOTOS).tolist(), MOST_POINTS), dtype=np.int64)
    row_of = np.full(count, -1)
    row_of[chosen] = np.arange(len(chosen))
    matched = np.zeros((len(chosen), len(photos)), dtype=bool)
    for column, sized in enumerate(photos):
        rows = row_of[sized.photo.points]
        matched[rows[rows >= 0], column] = True
    return chosen, matched


def _degrees_to_nearest(rays: np.ndarray, distances: np.ndarray, matched: np.ndarray) -> np.ndarray:
    """(P, K) degrees at each point from each photo to the nearest other one that matched it,
    180 for none near enough."""
    largest = np.full(matched.shape, -1.0)
    for number in range(matched.shape[1]):
        rows = matched[:, number]
        cosine = np.einsum("pkc,pc->pk", rays[rows], rays[rows, number])
        ratio = distances[rows] / np.maximum(distances[rows, number, None], 1e-12)
        cosine[(ratio < 1 / NEAR_DISTANCE) | (ratio > NEAR_DISTANCE)] = -1
        cosine[:, number] = -1
        largest[rows] = np.maximum(largest[rows], cosine)
    return np.degrees(np.arccos(np.clip(largest, -1, 1)))


def _is_hidden(
    rows: np.ndarray, pixels: np.ndarray, depths: np.ndarray, inside: np.ndarray, radius: float
) -> np.ndarray:
    """Which of these rows have another point in front of them, within `radius` (px) in the picture.

    pixels, depths: (P, 2) and (P,), of all points. inside: (P,), which of these the picture shows.
    """
    around = cKDTree(pixels[inside]).query(pixels[rows], k=FRONT_POINTS, distance_upper_bound=radius)[1]
    return (np.append(depths[inside], np.inf)[around] < FRONT_SHARE * depths[rows, None]).any(axis=1)


def _in_photo(
    number: int, sized: SizedPhoto, positions: np.ndarray, rays: np.ndarray, matched: np.ndarray, degrees: np.ndarray
) -> Sightings:
    """The sightings in one photo.

    number: the photo's. positions: (P, 3) points, scene frame. rays: (P, 3) unit vectors to them. matched: (P,) whether
    the photo matched them. degrees: (P,), see `_degrees_to_nearest`.
    """
    height, width = sized.pixels.shape[:2]
    diagonal = float(np.hypot(height, width))
    pixels, depths = sized.camera.project(positions)
    edge = EDGE * diagonal
    inside = (depths > 0) & ((pixels >= edge) & (pixels <= np.array([width, height]) - edge)).all(axis=1)
    rows = np.flatnonzero(inside & (matched | (degrees <= NEAR_DEGREES)))
    if len(rows):
        rows = rows[matched[rows] | ~_is_hidden(rows, pixels, depths, inside, FRONT_RADIUS * diagonal)]
    small = sized.camera.shrunk((BLURRED_PIXELS / (height * width)) ** 0.5)
    shrunk = cv2.resize(sized.pixels, (small.width, small.height), interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(shrunk.astype(np.float32) / 255, (0, 0), BLUR * np.hypot(small.width, small.height))
    at = (pixels[rows, ::-1] * (small.height / height, small.width / width) - 0.5).T
    colours = np.stack(
        [map_coordinates(channel, at, order=1, mode="nearest") for channel in np.moveaxis(blurred, 2, 0)], 1
    )
    if (opaque := sized.opaque) is not None:
        column, line = pixels[rows].astype(np.int64).T
        shown = opaque[line, column]
        rows, colours = rows[shown], colours[shown]
    return Sightings(
        photo=np.full(len(rows), number),
        point=rows,
        pixel=pixels[rows] / diagonal,
        colour=colours.astype(np.float64),
        towards=rays[rows],
        matched=matched[rows],
        degrees=degrees[rows],
    )
