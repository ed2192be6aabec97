"""Guided matching: features of two photos are matched once more,
each only with those that lie where the geometry of the pair puts it.

COLMAP can do this, too, but compares all descriptors and takes a second a pair. Here most are ruled out by their place
first: 20 times as fast.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap
from pycolmap import TwoViewGeometryConfiguration as Configuration

from core.data.sfm.disk_space import check_growth
from core.data.sfm.features import DATABASE, LEAST_INLIERS, PAIR_BYTES, USUAL_RATIO, images_in
from core.kernels.compiled import kernel
from core.report import Report
from core.system.threads import in_parallel

# F gives a feature's line in the other photo (E, if EXIF has both focal lengths).
ON_LINES = (Configuration.CALIBRATED, Configuration.UNCALIBRATED)
AT_POINTS = (Configuration.PLANAR, Configuration.PANORAMIC, Configuration.PLANAR_OR_PANORAMIC)  # H gives its point
NEAR_PX = 4.0  # COLMAP's, as all that follows
LARGEST = 0.7 * 512  # distance of matched descriptors, which are 512 long
FAR = np.iinfo(np.int32).max
BYTES = 128  # of a descriptor
EIGHT = 8  # flags that are tested together
PAIRS_AT_ONCE = 64  # whose features are in memory: up to 1 MB a photo


class Features(NamedTuple):
    """pixels: (n, 2) float32. descriptors: (n, BYTES) uint8, SIFT as COLMAP stores them.
    intrinsics: (3, 3), of a camera without distortion."""

    pixels: np.ndarray
    descriptors: np.ndarray
    intrinsics: np.ndarray


def guide(work: Path, pairs: Sequence[tuple[str, str]], report: Report) -> None:
    """Replace the matches of each pair in the database that has a geometry by guided ones.
    A second call changes nothing."""
    with pycolmap.Database.open(work / DATABASE) as database:
        images = images_in(database)
        for start in range(0, len(pairs), PAIRS_AT_ONCE):
            some = pairs[start : start + PAIRS_AT_ONCE]
            check_growth(work / DATABASE, len(some) * PAIR_BYTES)
            _guide_some(database, [(images[first].image_id, images[second].image_id) for first, second in some])
            report.progress("Guided matches", start + len(some), len(pairs))


def _guide_some(database: pycolmap.Database, pairs: list[tuple[int, int]]) -> None:
    geometries = [(pair, database.read_two_view_geometry(*pair)) for pair in pairs]  # undefined where there is none
    usable = [(pair, geometry) for pair, geometry in geometries if geometry.config in ON_LINES + AT_POINTS]
    features = {number: _features(database, number) for number in {number for pair, _ in usable for number in pair}}

    def match(begin: int, end: int) -> None:
        for (first, second), geometry in usable[begin:end]:
            geometry.inlier_matches = guided_matches(features[first], features[second], geometry)

    in_parallel(match, len(usable), 1)
    for pair, geometry in usable:
        database.update_two_view_geometry(
            *pair, geometry if len(geometry.inlier_matches) >= LEAST_INLIERS else pycolmap.TwoViewGeometry()
        )


def _features(database: pycolmap.Database, number: int) -> Features:
    pixels = np.ascontiguousarray(database.read_keypoints(number)[:, :2], np.float32)
    camera = database.read_camera(database.read_image(number).camera_id)
    return Features(pixels, database.read_descriptors(number).data, camera.calibration_matrix())


def guided_matches(first: Features, second: Features, geometry: pycolmap.TwoViewGeometry) -> np.ndarray:
    """(k, 2) uint32: pairs of a feature of the first and one of the second photo, each the other's nearest in
    descriptor among those that the geometry allows, and clearly so (Lowe 2004, 7.1)."""
    at_points, n = geometry.config in AT_POINTS, len(first.pixels)
    both = n + len(second.pixels)
    nearest, partner = np.full((both, 2), FAR, np.int32), np.full(both, -1, np.int32)
    matrix = geometry.H if at_points else _fundamental(first, second, geometry)
    assert matrix is not None  # COLMAP stores what the configuration says
    features = (first.pixels, first.descriptors, second.pixels, second.descriptors)
    most_alike_near(*features, matrix.astype(np.float32), at_points, np.float32(NEAR_PX**2), nearest, partner)
    clear = (nearest[:, 0] <= LARGEST**2) & (nearest[:, 0] < USUAL_RATIO**2 * nearest[:, 1])
    partners = partner[:n]
    chosen = np.flatnonzero(clear[:n] & clear[n + partners] & (partner[n + partners] == np.arange(n)))
    return np.column_stack([chosen, partners[chosen]]).astype(np.uint32)


def _fundamental(first: Features, second: Features, geometry: pycolmap.TwoViewGeometry) -> np.ndarray | None:
    """F; for calibrated photos computed from E, which is more certain than an F estimated beside it."""
    if geometry.config == Configuration.UNCALIBRATED:
        return geometry.F
    return np.linalg.inv(second.intrinsics).T @ geometry.E @ np.linalg.inv(first.intrinsics)


@kernel
def most_alike_near(pixels1, descriptors1, pixels2, descriptors2, matrix, at_points, limit, nearest, partner):
    """For each feature of either photo, the two smallest squared distances of its descriptor to
    those of the other photo's features that lie near.

    matrix: (3, 3) float32, H if `at_points`, else F, from the first photo to the second. limit: px², the largest
    squared distance to where H puts a feature or, with F, the largest squared Sampson distance (Hartley & Zisserman,
    eq. 11.9). Outputs, the first photo's features before the second's: nearest, (n + m, 2) int32, to be filled with FAR
    before; partner, (n + m,) int32, the feature at the smaller distance.
    """
    n, m = len(pixels1), len(pixels2)
    x2, y2, slack2 = np.empty(m, np.float32), np.empty(m, np.float32), np.empty(m, np.float32)
    near = np.zeros((m + EIGHT - 1) // EIGHT * EIGHT, np.uint8)
    eights = near.view(np.uint64)
    for j in range(m):
        x, y = pixels2[j]
        x2[j], y2[j] = x, y
        a, b = matrix[0, 0] * x + matrix[1, 0] * y + matrix[2, 0], matrix[0, 1] * x + matrix[1, 1] * y + matrix[2, 1]
        slack2[j] = limit * (a * a + b * b)
    for i in range(n):
        x, y = pixels1[i]
        a = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]
        b = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]
        c = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
        if at_points:
            a, b = a / c, b / c
            for j in range(m):
                near[j] = (x2[j] - a) * (x2[j] - a) + (y2[j] - b) * (y2[j] - b) <= limit
        else:
            slack1 = limit * (a * a + b * b)
            for j in range(m):
                off = a * x2[j] + b * y2[j] + c
                near[j] = off * off <= slack1 + slack2[j]
        for eight in range(len(eights)):
            if eights[eight] == 0:
                continue
            for j in range(EIGHT * eight, EIGHT * eight + EIGHT):
                if near[j] == 0:
                    continue
                distance = np.int32(0)
                for k in range(BYTES):
                    apart = np.int32(descriptors1[i, k]) - np.int32(descriptors2[j, k])
                    distance += apart * apart
                for row, other in ((i, j), (n + j, i)):
                    if distance < nearest[row, 0]:
                        nearest[row, 1], nearest[row, 0], partner[row] = nearest[row, 0], distance, other
                    elif distance < nearest[row, 1]:
                        nearest[row, 1] = distance
