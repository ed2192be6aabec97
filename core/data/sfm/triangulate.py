"""Points of photos whose cameras are known: features are matched and triangulated, with pycolmap, on a CPU."""

from pathlib import Path

import numpy as np
import pycolmap

from core.data.collection import Photo, spread_over
from core.data.formats.model_file import quiet
from core.data.photos.distortion import rays
from core.data.sfm.features import (
    DATABASE,
    LEAST_PHOTOS,
    MASKS,
    PHOTOS,
    SEED,
    extract,
    images_in,
    match,
    write_pictures,
)
from core.errors import BadInput
from core.report import Report
from core.scene.camera import Camera
from core.words import counted

NEAREST, SPREAD = 10, 10  # partners of a photo: the nearest ones, and others evenly spread over those that look its way
MOST_DEGREES = 75.0  # between the directions in which partners look; SIFT matches little beyond 40
# Laxer than the usual 0.8, as matches are then tested against known epipolar lines: plaza, Liberty and kermit get 98,
# 13, 15 % more points. Each of COLMAP's own points then has one nearer by 29, 6, 5 %, and each of these has COLMAP's
# nearest farther off by 10, 8, 45 % (medians).
RATIO = 0.85
EPIPOLAR_PX = 2.0  # how far a match may lie off the line on which the other camera's ray is seen


def triangulate(posed: list[tuple[Photo, Camera]], work: Path, report: Report) -> tuple[pycolmap.Reconstruction, float]:
    """A COLMAP model of the photos at their given cameras (world units), with the points that they see; images are
    named as photos. Also returns the share of all matches that agree with these cameras, in [0, 1].

    Features come from the undistorted pictures, except where these are masked. As the cameras are known, matches are
    tested against their epipolar lines, not against an estimated geometry, and two photos are enough for a point. work:
    an empty folder. Photos that cannot be decoded are left out; training names them. Raises BadInput for fewer than
    LEAST_PHOTOS. Two runs agree bit for bit.
    """
    with quiet():
        cameras = write_pictures(posed, work, report)
        names = list(cameras)
        if len(names) < LEAST_PHOTOS:
            what = (
                f"{counted(len(names), 'photo')} to train on can be read; "
                f"at least {LEAST_PHOTOS} are needed to triangulate points"
            )
            raise BadInput(f"{what}.", "Add photos, or points to start from (ply_file_path in a transforms.json).")
        extract(work, names, report, work / MASKS)
        pairs = [
            (names[first], names[second]) for first, second in partners([camera for _, camera in cameras.values()])
        ]
        match(work, pairs, report, verify=False, ratio=RATIO)
        known = _known(work, cameras)
        near = _keep_epipolar(work, cameras, pairs)
        (work / "model").mkdir()
        options = pycolmap.IncrementalPipelineOptions()
        options.min_num_matches = 1  # 15 are for an estimate
        options.triangulation.ignore_two_view_tracks = False
        options.random_seed = SEED
        options.num_threads = 1  # several would add up in another order each time; 30,000 observations take it 1.5 s
        model = pycolmap.triangulate_points(known, work / DATABASE, work / PHOTOS, work / "model", options=options)
    for image in model.images.values():
        image.name = cameras[image.name][0].name
    return model, near


def partners(cameras: list[Camera]) -> list[tuple[int, int]]:
    """The pairs (first > second) of cameras whose photos are worth matching;
    their number is linear in that of the cameras.

    Of those that look in about the same direction, each camera is paired with the NEAREST ones, for detail, and SPREAD
    others, for wide angles.
    """
    centres = np.array([camera.centre for camera in cameras])
    forward = np.array([camera.world_to_camera[2] for camera in cameras])
    pairs = set()
    for number in range(len(cameras)):
        alike = forward @ forward[number] > np.cos(np.radians(MOST_DEGREES))
        alike[number] = False
        rows = np.flatnonzero(alike)
        distances = np.linalg.norm(centres[rows] - centres[number], axis=1)
        nearest_first = rows[np.argsort(distances, kind="stable")].tolist()
        chosen = (*nearest_first[:NEAREST], *spread_over(nearest_first[NEAREST:], SPREAD))
        pairs |= {(max(number, other), min(number, other)) for other in chosen}
    return sorted(pairs)


def sampson_distance_px(first: Camera, second: Camera, in_first: np.ndarray, in_second: np.ndarray) -> np.ndarray:
    """(N,) px by which matches, (N, 2) in each picture, violate the epipolar geometry:
    the Sampson distance (Hartley & Zisserman, eq. 11.9)."""
    turn = second.world_to_camera @ first.world_to_camera.T
    x, y, z = second.world_to_camera @ (first.centre - second.centre)
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ turn
    of_first, of_second = (
        rays(pixels, c.fx, c.fy, c.cx, c.cy) for c, pixels in ((first, in_first), (second, in_second))
    )
    lines = of_second @ essential, of_first @ essential.T  # in the first and in the second picture
    error = np.einsum("ij,ij->i", of_second, lines[1])
    slopes = [line[:, :2] / (camera.fx, camera.fy) for camera, line in zip((first, second), lines, strict=True)]
    steepness = np.sqrt((slopes[0] ** 2).sum(axis=1) + (slopes[1] ** 2).sum(axis=1))
    return np.abs(error) / np.maximum(steepness, np.finfo(float).tiny)


def _known(work: Path, cameras: dict[str, tuple[Photo, Camera]]) -> pycolmap.Reconstruction:
    """The model without points, in which photos and cameras have their ids from the database."""
    known = pycolmap.Reconstruction()
    with pycolmap.Database.open(work / DATABASE) as database:
        images = images_in(database)
        for name, (_, camera) in cameras.items():
            image = images[name]
            params = [camera.fx, camera.fy, camera.cx, camera.cy]
            size = {"width": camera.width, "height": camera.height}
            lens = pycolmap.Camera(camera_id=image.camera_id, model="PINHOLE", **size, params=params)
            database.update_camera(lens)  # from COLMAP's guess; the two have to agree
            known.add_camera_with_trivial_rig(lens)
            rotation = camera.world_to_camera
            pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ camera.centre)
            posed = pycolmap.Image(name=name, camera_id=image.camera_id, image_id=image.image_id)
            known.add_image_with_trivial_frame(posed, pose)
    return known


def _keep_epipolar(work: Path, cameras: dict[str, tuple[Photo, Camera]], pairs: list[tuple[str, str]]) -> float:
    """Keep the matches that agree with the cameras; returns their share of all, 1 if there are none."""
    total = kept = 0
    with pycolmap.Database.open(work / DATABASE) as database:
        numbers = {name: image.image_id for name, image in images_in(database).items()}
        pixels = {name: database.read_keypoints(number)[:, :2].astype(np.float64) for name, number in numbers.items()}
        for first, second in pairs:
            found = database.read_matches(numbers[first], numbers[second])
            if not len(found):
                continue
            places = pixels[first][found[:, 0]], pixels[second][found[:, 1]]
            near = sampson_distance_px(cameras[first][1], cameras[second][1], *places) <= EPIPOLAR_PX
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
            geometry.inlier_matches = found[near].astype(np.uint32)
            database.write_two_view_geometry(numbers[first], numbers[second], geometry)
            total, kept = total + len(near), kept + int(near.sum())
    return kept / total if total else 1.0
