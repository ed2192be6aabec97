"""Locates a photo from outside a collection: its camera,
from features matched with the collection's landmarks (pycolmap, CPU)."""

from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap
from PIL import Image, ImageOps

from core.data.collection import Photo
from core.data.formats.model_file import quiet
from core.data.photos.file import probe
from core.data.placing import focal_length_of, is_usual
from core.data.sfm.features import DATABASE, JPEG_QUALITY, MASKS, PHOTOS, SEED, extract, images_in, match, write_picture
from core.data.sfm.landmarks import NEAR_PX, NO_POINT, Landmarks
from core.report import Report
from core.scene.camera import Camera
from core.system.atomic import scratch

QUERY = "query.jpg"
OFF = 0.006  # RANSAC's largest reprojection error, of the long side: 10 of 1600 px; COLMAP takes 12
USUAL_FOCAL_LENGTH = 1.2  # long sides, COLMAP's guess to start from
# Training photos, each located by the others: 17 of 19 of the Statue of Liberty are found to within 1 px of 400, with
# 13 to 296 inliers, 44 to 100 % of all matches; wrong matches alone give at most 11 inliers of 332. Of its mirrored
# photos, which show another place, 7 of 76 had 12 to 22 inliers, a third to 60 % of all matches, as the two sides of a
# statue look alike; all of these had more once they were mirrored back.
LEAST_AGREEING, LEAST_SHARE = 12, 1 / 3
SURE = 50  # with this many inliers, the mirrored photo need not be tried


@dataclass(frozen=True)
class Located:
    """camera: a pinhole in the collection's scene frame, at the size of the photo as displayed.
    agreeing: inliers among what `matched`, which is of this kind, in words."""

    camera: Camera
    agreeing: int
    matched: int
    kind: str = "features"


def locate(path: Path, landmarks: Landmarks, report: Report, mask: Path | None = None) -> Located | None:
    """The camera of a photo file; None if too few of its features match the landmarks or agree on a camera.

    Features are matched with the landmarks photo by photo; each match pairs a pixel with a point, and the camera
    follows from these pairs (`pose_of`). If more features agree once the photo is mirrored, it shows another place.
    mask: a picture, white where the photo is to be used.
    The result is the same for any number of threads. Raises BadInput for a photo that cannot be read, or that its mask
    hides altogether.
    """
    size = probe(path).displayed
    photo = Photo.from_outside(path, anywhere(size), mask)
    with scratch("locate") as work, quiet():
        camera = write_picture(photo, photo.camera, work, QUERY)
        lens = lens_of(path, camera.width, camera.height)

        def located() -> Located | None:
            extract(work, [QUERY], report, work / MASKS)
            return camera_of(*_matched(work, landmarks, report), lens, size)

        found = located()
        if found is None or found.agreeing >= SURE:
            return found
        _mirror(work)
        mirrored = located()
    return None if mirrored is not None and mirrored.agreeing > found.agreeing else found


def _mirror(work: Path) -> None:
    """Mirror the picture QUERY and its mask, and forget its features."""
    for path in (work / PHOTOS / QUERY, work / MASKS / f"{QUERY}.png"):
        ImageOps.mirror(Image.open(path)).save(path, quality=JPEG_QUALITY)
    (work / DATABASE).unlink()


def _matched(work: Path, landmarks: Landmarks, report: Report) -> tuple[np.ndarray, np.ndarray]:
    """(n, 2) pixels of the picture QUERY, and the (n, 3) points that they match; each pair once."""
    starts = np.cumsum(landmarks.counts) - landmarks.counts
    rows = {
        f"{number}.jpg": slice(start, start + count)
        for number, (start, count) in enumerate(zip(starts, landmarks.counts, strict=True))
    }
    with pycolmap.Database.open(work / DATABASE) as database:
        numbers = {name: _add(database, name, landmarks.descriptors[row]) for name, row in rows.items()}
    match(work, [(QUERY, name) for name in rows], report, verify=False)
    pairs = [np.zeros((0, 2), dtype=np.int64)]  # feature of the query, point
    with pycolmap.Database.open(work / DATABASE) as database:
        query = images_in(database)[QUERY].image_id
        for name, row in rows.items():
            feature, landmark = database.read_matches(query, numbers[name]).T
            pairs.append(np.column_stack([feature, landmarks.shows[row][landmark]]))
        feature, point = np.unique(np.concatenate(pairs), axis=0).T
        pixels = database.read_keypoints(query)[feature, :2].astype(np.float64)
    is_point = point != NO_POINT
    return pixels[is_point], landmarks.points[point[is_point]]


def _add(database: pycolmap.Database, name: str, descriptors: np.ndarray) -> int:
    """Add an image with these descriptors, (n, 128) uint8, at no particular pixels; returns its id."""
    lens = database.write_camera(pycolmap.Camera(model="SIMPLE_PINHOLE", width=1, height=1, params=[1, 0, 0]))
    number = database.write_image(pycolmap.Image(name=name, camera_id=lens))
    database.write_keypoints(number, np.zeros((len(descriptors), 2), np.float32))
    database.write_descriptors(number, pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType.SIFT, descriptors))
    return number


def anywhere(size: tuple[int, int]) -> Camera:
    """A camera that takes pictures of this size, of which nothing else is known."""
    long_side, (width, height) = max(size), size
    return Camera(np.eye(3), np.zeros(3), long_side, long_side, width / 2, height / 2, width, height)


def lens_of(path: Path, width: int, height: int) -> pycolmap.Camera:
    """A pinhole of this size (px), with the focal length of the photo's EXIF if it gives one."""
    length, known = USUAL_FOCAL_LENGTH, False
    with suppress(ValueError):  # a format that COLMAP does not read
        said = pycolmap.infer_camera_from_image(path)
        if said.has_prior_focal_length:
            length, known = focal_length_of(said), True
    params = [length * max(width, height), width / 2, height / 2]
    lens = pycolmap.Camera(model="SIMPLE_PINHOLE", width=width, height=height, params=params)
    lens.has_prior_focal_length = known
    return lens


class Pose(NamedTuple):
    """camera: a pinhole of the lens's size. agree: (n,) bool, the matches that agree on it."""

    camera: Camera
    agree: np.ndarray


def pose_of(pixels: np.ndarray, points: np.ndarray, lens: pycolmap.Camera, off_px: float) -> Pose | None:
    """The camera that sees the points at these pixels of `lens`, to within off_px, on which most matches agree
    (P3P, or P4P if the focal length is unknown, in LO-RANSAC); None if there is none that could exist.

    If EXIF gives a focal length, an unknown one is tried as well, and that on which more features agree is taken:
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
    length = fitted.mean_focal_length()
    camera = Camera(rotation, centre, length, length, fitted.width / 2, fitted.height / 2, fitted.width, fitted.height)
    return Pose(camera, found["inlier_mask"])


def camera_of(pixels: np.ndarray, points: np.ndarray, lens: pycolmap.Camera, size: tuple[int, int]) -> Located | None:
    """The camera, for a picture of this `size`, that sees the points at these pixels of `lens`; None if too few agree.
    See `pose_of`."""
    pose = pose_of(pixels, points, lens, max(NEAR_PX, OFF * max(lens.width, lens.height)))
    if pose is None:
        return None
    agreeing = int(pose.agree.sum())
    # A point counts once, however many features match it.
    if len(np.unique(points[pose.agree], axis=0)) < LEAST_AGREEING or agreeing < LEAST_SHARE * len(points):
        return None
    return Located(pose.camera.resized(*size), agreeing, len(points))
