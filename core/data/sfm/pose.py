"""The camera of a photo, from points that it shows (pycolmap)."""

import tempfile
from contextlib import suppress
from copy import copy
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap
from PIL import Image

from core.data.photos.file import probe, upright_exif
from core.data.placing import focal_length_of, is_usual
from core.data.sfm.features import SEED
from core.scene.camera import Camera
from core.system.atomic import temporary_root

USUAL_FOCAL_LENGTH = 1.2  # long sides, COLMAP's guess to start from
STAND_IN_PX = 1000  # the longer side of a JPEG that only tells COLMAP the shape and the EXIF of a photo


def pinhole_of(path: Path, width: int, height: int) -> pycolmap.Camera:
    """A pinhole of this size (px), with the focal length of the photo's EXIF if it gives one.
    Raises BadInput for a file that is no photo."""
    in_exif = _focal_length_in_exif(path)
    params = [(in_exif or USUAL_FOCAL_LENGTH) * max(width, height), width / 2, height / 2]
    lens = pycolmap.Camera(model="SIMPLE_PINHOLE", width=width, height=height, params=params)
    lens.has_prior_focal_length = in_exif is not None
    return lens


def _focal_length_in_exif(path: Path) -> float | None:
    """The focal length over the longer side, as COLMAP reads it from EXIF. It does so in JPEGs only: of other photos,
    the EXIF is put into a black JPEG of the same shape."""
    header = probe(path)
    if header.is_jpeg:
        return _focal_length_in_jpeg(path)
    if not header.exif:
        return None
    share = min(1, STAND_IN_PX / max(header.width, header.height))
    black = Image.new("L", (max(1, round(share * header.width)), max(1, round(share * header.height))))
    with tempfile.TemporaryDirectory(dir=temporary_root()) as folder:
        black.save(Path(folder, "exif.jpg"), exif=upright_exif(header.exif))
        return _focal_length_in_jpeg(Path(folder, "exif.jpg"))


def _focal_length_in_jpeg(path: Path) -> float | None:
    with suppress(ValueError):  # COLMAP cannot read it
        camera = pycolmap.infer_camera_from_image(path)
        return focal_length_of(camera) if camera.has_prior_focal_length else None
    return None


class Pose(NamedTuple):
    """camera: a pinhole of the lens's size. inliers: (n,) bool, the matches that agree on it."""

    camera: Camera
    inliers: np.ndarray


def pose_of(pixels: np.ndarray, points: np.ndarray, lens: pycolmap.Camera, off_px: float) -> Pose | None:
    """The camera that sees the points at these pixels of `lens`, to within off_px, on which most matches agree
    (P3P, or P4P if the focal length is unknown, in LO-RANSAC); None if there is none that could exist.

    If EXIF gives a focal length, an unknown one is tried as well, and that on which more matches agree is taken:
    programs that crop a photo leave its EXIF as it was.
    """
    if not len(points):
        return None
    estimation, refinement = pycolmap.AbsolutePoseEstimationOptions(), pycolmap.AbsolutePoseRefinementOptions()
    estimation.ransac.max_error = off_px
    estimation.ransac.random_seed = SEED
    refinement.refine_focal_length = True
    answers = []
    for unknown in (False, True) if lens.has_prior_focal_length else (True,):
        estimation.estimate_focal_length, fitted = unknown, copy(lens)
        answer = pycolmap.estimate_and_refine_absolute_pose(pixels, points, fitted, estimation, refinement)
        if answer is not None:
            answers.append((answer, fitted))
    if not answers:
        return None
    found, fitted = max(answers, key=lambda each: each[0]["num_inliers"])
    if not is_usual(fitted):
        return None
    rotation = found["cam_from_world"].rotation.matrix()
    centre = -rotation.T @ found["cam_from_world"].translation
    camera = Camera.centred(rotation, centre, fitted.mean_focal_length(), fitted.width, fitted.height)
    return Pose(camera, found["inlier_mask"])
