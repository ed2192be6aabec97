"""The COLMAP model of the photos, with the faults of a real one: noise, wrong matches, points on passers-by."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from samples.plaza_maker.cameras import View

SCALE = 0.25  # model units a metre; SfM knows no metres
# Square to model: about y down and z forward, a few degrees off.
ROTATION = cv2.Rodrigues(np.radians([-84.0, 5.0, -3.0]))[0]
ORIGIN = np.array([2.0, -6.0, 4.0])  # the model's origin in the square, metres
POSE_NOISE_DEGREES, CENTRE_NOISE, FOCAL_NOISE = 0.025, 0.010, 0.0007  # standard deviations; centres in metres
FEATURE_NOISE_PX = 0.35
POINTS, WRONG, ON_PASSERS_BY = 4600, 110, 260


@dataclass(frozen=True)
class Taken:
    """A photo with what the tracks are made from.

    photo: (H, W, 3) 8-bit RGB. depth: (H, W) metres along the axis. transient: (H, W) bool.
    """

    name: str
    view: View
    photo: np.ndarray
    depth: np.ndarray
    transient: np.ndarray


_Track = list[tuple[int, np.ndarray]]  # observations of one point: (photo number, pixel)


def to_model(points: np.ndarray) -> np.ndarray:
    """Metres of the square (P, 3) to model units."""
    return SCALE * (points - ORIGIN) @ ROTATION.T


def _lifted(taken: Taken, pixels: np.ndarray) -> np.ndarray:
    """The points of the square (P, 3) seen at pixels (P, 2), which are middles of pixels."""
    rows, columns = pixels[:, 1].astype(int), pixels[:, 0].astype(int)
    view = taken.view
    local = np.stack(
        [(pixels[:, 0] - view.width / 2) / view.focal_px, (pixels[:, 1] - view.height / 2) / view.focal_px], axis=1
    )
    local = np.concatenate([local, np.ones((len(local), 1))], axis=1) * taken.depth[rows, columns, None]
    return local @ view.world_to_camera + view.centre


def _features(taken: Taken) -> np.ndarray:
    """Corners on surfaces that stay, away from depth edges, as middles of pixels (P, 2)."""
    grey = cv2.cvtColor(taken.photo, cv2.COLOR_RGB2GRAY)
    clahe = cv2.createCLAHE(3.0, (6, 6)).apply(grey)
    depth = np.where(np.isfinite(taken.depth), taken.depth, 1e4).astype(np.float32)
    smooth = cv2.dilate(depth, np.ones((3, 3))) < 1.04 * cv2.erode(depth, np.ones((3, 3)))
    moving = cv2.dilate(taken.transient.astype(np.uint8), np.ones((5, 5))) > 0
    usable = (smooth & ~moving & (depth < 110)).astype(np.uint8)
    corners = cv2.goodFeaturesToTrack(clahe, 420, 0.01, 4, mask=usable)
    return np.zeros((0, 2)) if corners is None else corners.reshape(-1, 2).astype(float) + 0.5


def _sees(taken: Taken, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which points (P, 3) a photo shows, not hidden by anything, and where: (P,) bool, (P, 2) px."""
    pixels, depth = taken.view.project(points)
    inside = (
        (depth > 0.5) & (pixels > 3).all(axis=1) & (pixels < [taken.view.width - 3, taken.view.height - 3]).all(axis=1)
    )
    columns, rows = (np.where(inside, pixels[:, axis], 0).astype(int) for axis in (0, 1))
    close = np.abs(taken.depth[rows, columns] - depth) < 0.012 * depth + 0.05
    return inside & close & ~taken.transient[rows, columns], pixels


def _matchable(taken: Taken) -> float:
    """How readily a photo is matched, 0.35 to 1: dark and hazy ones less than others."""
    contrast = cv2.Laplacian(cv2.cvtColor(taken.photo, cv2.COLOR_RGB2GRAY), cv2.CV_32F)
    return np.clip(np.abs(contrast).mean() / 12, 0.35, 1)


def _static_tracks(photos: list[Taken], rng: np.random.Generator) -> list[_Track]:
    """Tracks of three or more observations, without noise, on the landmark and the square."""
    tracks = []
    matchable = [_matchable(taken) for taken in photos]
    for number, taken in enumerate(photos):
        pixels = _features(taken)
        points = _lifted(taken, pixels)
        own = [[(number, pixel)] for pixel in pixels]
        towards = points - taken.view.centre
        size = taken.view.focal_px / np.linalg.norm(towards, axis=1)
        for other, witness in enumerate(photos):
            if other == number:
                continue
            seen, where = _sees(witness, points)
            away = points - witness.view.centre
            cosine = (towards * away).sum(1) / (np.linalg.norm(towards, axis=1) * np.linalg.norm(away, axis=1))
            ratio = witness.view.focal_px / np.linalg.norm(away, axis=1) / size
            chance = (
                0.55 * matchable[other] * np.clip((cosine - 0.6) / 0.3, 0, 1) * np.exp(-((np.log2(ratio) / 1.1) ** 2))
            )
            for index in np.flatnonzero(seen & (rng.random(len(points)) < chance)):
                own[index].append((other, where[index]))
        tracks += [track for track in own if len(track) >= 3]
    chosen = rng.permutation(len(tracks))[: 2 * POINTS]
    return [tracks[index] for index in chosen]


def _loose_tracks(
    photos: list[Taken], rng: np.random.Generator, count: int, on_passers_by: bool
) -> list[tuple[_Track, np.ndarray]]:
    """Short tracks, each with the (wrong) place that it is taken for: on passers-by, or of matches far off in depth."""
    result: list[tuple[_Track, np.ndarray]] = []
    while len(result) < count:
        number = int(rng.integers(len(photos)))
        taken = photos[number]
        eligible = np.argwhere(taken.transient if on_passers_by else np.isfinite(taken.depth) & ~taken.transient)
        if not len(eligible):
            continue
        row, column = eligible[rng.integers(len(eligible))]
        pixel = np.array([[column + 0.5, row + 0.5]])
        point = _lifted(taken, pixel)
        if not on_passers_by:
            point = taken.view.centre + (point - taken.view.centre) * np.exp(rng.uniform(-1.2, 0.9))
        track = [(number, pixel[0])]
        for other in rng.permutation(len(photos))[:12]:
            pixels, depth = photos[other].view.project(point)
            size = np.array([photos[other].view.width, photos[other].view.height])
            if other != number and depth[0] > 1 and (pixels > 2).all() and (pixels < size - 2).all():
                track.append((int(other), pixels[0] + rng.normal(0, 0.8, 2)))
            if len(track) == 2 + (rng.random() < 0.3):
                break
        if len(track) >= 2:
            result.append((track, point[0]))
    return result


@dataclass(frozen=True)
class _Camera:
    """A camera as SfM believes it to be, in model units."""

    world_to_camera: np.ndarray
    centre: np.ndarray
    focal_px: float
    middle: np.ndarray

    def project(self, points: np.ndarray) -> np.ndarray:
        local = (points - self.centre) @ self.world_to_camera.T
        return local[:, :2] / local[:, 2:] * self.focal_px + self.middle


def _believed(view: View, rng: np.random.Generator) -> _Camera:
    """The camera of a view, with errors as of SfM."""
    wobble = cv2.Rodrigues(np.radians(rng.normal(0, POSE_NOISE_DEGREES, 3)))[0]
    centre = to_model((view.centre + rng.normal(0, CENTRE_NOISE, 3))[None])[0]
    focal = view.focal_px * (1 + rng.normal(0, FOCAL_NOISE))
    return _Camera(
        wobble @ view.world_to_camera @ ROTATION.T, centre, focal, np.array([view.width / 2, view.height / 2])
    )


def _triangulate(cameras: list[_Camera], pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """The point nearest to all rays, the nearer cameras weighing more;
    its errors (px), and the widest angle between two rays (degrees)."""
    rays = np.stack(
        [
            np.append((pixel - camera.middle) / camera.focal_px, 1.0) @ camera.world_to_camera
            for camera, pixel in zip(cameras, pixels)
        ]
    )
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    centres = np.stack([camera.centre for camera in cameras])
    weights = np.ones(len(rays))
    for _ in range(3):
        across = (np.eye(3) - rays[:, :, None] * rays[:, None, :]) * weights[:, None, None]
        point = np.linalg.lstsq(across.sum(0), (across @ centres[:, :, None]).sum(0)[:, 0], rcond=None)[0]
        focal = np.array([camera.focal_px for camera in cameras])
        weights = (focal / np.maximum(np.linalg.norm(point - centres, axis=1), 1e-3)) ** 2
    errors = np.array(
        [np.linalg.norm(camera.project(point[None])[0] - pixel) for camera, pixel in zip(cameras, pixels)]
    )
    angle = np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1, 1)))
    return point, errors, float(angle)


@dataclass(frozen=True)
class _Point:
    """A point of the model. place: model units. errors: px, of each observation of its track."""

    place: np.ndarray
    track: _Track
    errors: np.ndarray


def _points(photos: list[Taken], cameras: list[_Camera], rng: np.random.Generator) -> list[_Point]:
    """The triangulated points, then the wrong ones and those on passers-by."""
    points = []
    for exact in _static_tracks(photos, rng):
        track = [(number, pixel + rng.normal(0, FEATURE_NOISE_PX, 2)) for number, pixel in exact[:12]]
        place, errors, angle = _triangulate(
            [cameras[number] for number, _ in track], np.array([pixel for _, pixel in track])
        )
        if errors.max() < 4.0 and angle > 1.5:
            points.append(_Point(place, track, errors))
        if len(points) == POINTS:
            break
    loose = _loose_tracks(photos, rng, WRONG, False)
    if any(taken.transient.any() for taken in photos):
        loose += _loose_tracks(photos, rng, ON_PASSERS_BY, True)
    for track, metres in loose:
        place = to_model(metres[None])[0]
        errors = np.array([np.linalg.norm(cameras[number].project(place[None])[0] - pixel) for number, pixel in track])
        points.append(_Point(place, track, errors))
    return points


def _reconstruction(
    photos: list[Taken], cameras: list[_Camera], points: list[_Point], rng: np.random.Generator
) -> pycolmap.Reconstruction:
    """The model as COLMAP has it. Each photo also has a few features that matched nothing."""
    features: list[list[np.ndarray]] = [[] for _ in photos]
    tracks = []
    for point in points:
        track = pycolmap.Track()
        for number, pixel in point.track:
            track.add_element(number + 1, len(features[number]))
            features[number].append(pixel)
        tracks.append(track)
    for found, taken in zip(features, photos):
        found += list(rng.uniform(2, [taken.view.width - 2, taken.view.height - 2], (12, 2)))

    model = pycolmap.Reconstruction()
    for number, (taken, camera, found) in enumerate(zip(photos, cameras, features), start=1):
        params = [camera.focal_px, camera.focal_px, *camera.middle]
        size = {"width": taken.view.width, "height": taken.view.height}
        model.add_camera_with_trivial_rig(pycolmap.Camera(model="PINHOLE", **size, params=params, camera_id=number))
        image = pycolmap.Image(name=taken.name, keypoints=np.array(found), camera_id=number, image_id=number)
        pose = np.column_stack([camera.world_to_camera, -camera.world_to_camera @ camera.centre])
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
    for point, track in zip(points, tracks):
        shades = [photos[number].photo[int(pixel[1]), int(pixel[0])] for number, pixel in point.track]
        made = model.add_point3D(point.place, track, np.mean(shades, axis=0).round().astype(np.uint8))
        model.points3D[made].error = float(point.errors.mean())
    return model


def write_model(photos: list[Taken], folder: Path, seed: int) -> dict:
    """Write the photos' model as binary files into a folder; returns its figures (counts, mean error in px)."""
    rng = np.random.default_rng(seed)
    cameras = [_believed(taken.view, rng) for taken in photos]
    points = _points(photos, cameras, rng)
    folder.mkdir(parents=True, exist_ok=True)
    _reconstruction(photos, cameras, points, rng).write_binary(str(folder))
    return {
        "points": len(points),
        "observations": sum(len(point.track) for point in points),
        "mean_reprojection_error_px": round(float(np.mean(np.concatenate([point.errors for point in points]))), 3),
    }
