"""Points for what was cut out of empty space, features or not: spread at random over its visual hull (Laurentini 1994),
which is all that no photo shows as empty."""

from contextlib import suppress

import numpy as np

from core.data.collection import Photo
from core.data.photos.pixels import load_photo
from core.data.sfm.features import HALF, SEED
from core.errors import BadInput
from core.report import Report
from core.scene.camera import Camera

# Points in the cube that the cameras look at; 3DGS starts Blender scenes from as many. Beside triangulated points, they
# gain 1.5 dB where one of four balls has texture (held out, 500 steps), and nothing where all have (1,200 steps).
TRIED = 100_000
LONG_SIDE_PX = 400  # of silhouettes


def points_in_silhouettes(posed: list[tuple[Photo, Camera]], report: Report) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) float64 in the units of the cameras, and colours (n, 3) uint8: the means over the photos.

    None at all if no photo has empty space, or the silhouettes do not meet, as those of wrong poses.
    """
    middle, half = _cube([camera for _, camera in posed])
    points = middle + half * np.random.default_rng(SEED).uniform(-1, 1, (TRIED, 3))
    sums, counts, cut_out = np.zeros((TRIED, 3)), np.zeros(TRIED), False
    for number, (photo, whole) in enumerate(posed, 1):
        camera = whole.within(LONG_SIDE_PX)
        with suppress(BadInput):
            loaded = load_photo(photo, camera.width, camera.height, transparent_is_empty=True)
            empty = np.zeros((camera.height, camera.width)) if loaded.empty is None else loaded.empty
            seen = np.flatnonzero(camera.shows(points)[0])
            pixels, _ = camera.project(points[seen])
            column, row = np.minimum(pixels.astype(np.int64), (camera.width - 1, camera.height - 1)).T
            kept = np.ones(len(points), bool)
            kept[seen] = empty[row, column] < HALF
            sums[seen] += loaded.pixels[row, column]
            counts[seen] += 1
            points, sums, counts = points[kept], sums[kept], counts[kept]
            cut_out |= loaded.empty is not None
        report.progress("Silhouettes", number, len(posed))
    inside = counts > 0 if cut_out else np.zeros(len(points), bool)
    return points[inside], (sums[inside] / counts[inside, None]).round().astype(np.uint8)


def _cube(cameras: list[Camera]) -> tuple[np.ndarray, float]:
    """The point nearest to the axes of all cameras (least squares),
    and how far around it the median camera sees, which is half a side of the cube."""
    forward = np.array([camera.world_to_camera[2] for camera in cameras])
    centres = np.array([camera.centre for camera in cameras])
    across = np.eye(3) - forward[:, :, None] * forward[:, None]
    middle = np.linalg.lstsq(across.sum(axis=0), np.einsum("nij,nj->i", across, centres))[0]
    sights = [min(camera.width / camera.fx, camera.height / camera.fy) / 2 for camera in cameras]
    return middle, float(np.median(np.linalg.norm(centres - middle, axis=1) * sights))
