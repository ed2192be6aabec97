"""Finds where a photo from outside was taken by comparing it with pictures of the scene in the photo's own look.

Where light and season differ, features of other photos often do not match; but a picture of the scene in the photo's
look resembles the photo. It is compared with what the training cameras see; the most similar of these pictures tell a
camera, which sees a picture more similar yet, and so on, until no more of the matches agree.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap
import torch
from jaxtyping import Bool, Float

from core.data.collection import Photo, spread_over
from core.data.photos.file import probe
from core.data.photos.pixels import load_photo
from core.data.sfm.pose import pinhole_of, pose_of
from core.looks.oriented_gradients import GRID_PX, GridFeatures, Pairs, coherence, matches, matches_nearby
from core.looks.trained import Look, TrainedRun, bake
from core.report import Report
from core.scene.camera import Camera
from core.scene.harmonics import dc_of_colour
from core.scene.splats import Splats
from core.system.device import sent
from core.system.threads import mapped_in_parallel, threads_for_blocks

VIEWS = 64  # training cameras that a photo is compared with, at most
AT_ONCE = 8  # training cameras between two reports of progress
# The longer sides of pictures: to choose among these cameras, and from there on. A photo from nearer by resembles their
# pictures once it is smaller.
COARSE_PX, FINE_PX = (160, 107), 320
# Of these cameras, at each size: by how coherent their matches are. Of plaza and the Statue's held-out photos, the best
# start was among the first five.
LIKELY = 12
TRIES = 4  # starts from which the pose is iterated, those of most inliers
ROUNDS = 20  # of iteration from one start, at most
# So many rounds in turn may multiply the inliers by less than GAIN. Where the focal length is unknown, their number
# may fall on the way: for plaza's 0040.jpg from 427 to 423, then it rises to 762, beyond the 543 of one column aside.
GAIN, PATIENCE = 1.02, 2
WIDER = 0.75  # the focal length of a camera that is tried beside one that may be too near or too far off
REACH, LEAST_ALIKE = 4, 0.5  # of a place in the next picture: points of the grid; the cosine of its features
PLACE = 0.7  # a pixel of which the place makes up less is sky
# Held-out photos of plaza and of the Statue of Liberty end with 383 to 1,704 inliers, 62 to 100% of all matches; photos
# of other places, on plaza, with 83 at most, 48% at most. Two of plaza ended far off: one too blurred to show anything
# with 120 of 237, one without its lower half with 134 of 226. Times their share, these are 61 and 79; of one shrunk to
# 60 px, 100 of 107 are 93.
LEAST_INLIERS, LEAST_SHARE = 90, 0.5  # the first times the share
SURE = 0.75  # with this share, no other start is tried; those that end beside the camera had 0.53 and 0.57


class Located(NamedTuple):
    """camera: a pinhole in the scene frame, at the size at which the photo was compared; what `locate` returns, at that
    of the photo as displayed. inliers: how many of the matches agree with it. matches: how many there were."""

    camera: Camera
    inliers: int
    matches: int


class Query(NamedTuple):
    """The photo at one size. lens: a pinhole of that size, with the focal length that is known of the photo, if any."""

    lens: pycolmap.Camera
    features: GridFeatures


class Rendered(NamedTuple):
    """A rendered picture of the scene, which the photo is compared with.

    points: what the points of its grid show, scene frame, row by row. is_place: whether that is the place, and not the
    sky.
    """

    features: GridFeatures
    points: Float[np.ndarray, "n 3"]
    is_place: Bool[np.ndarray, " n"]


class Candidate(NamedTuple):
    """The photo at one size beside what a training camera sees, and which of their points match."""

    query: Query
    reference: Rendered
    pairs: Pairs


@torch.no_grad()
def locate(trained: TrainedRun, look: Look, path: Path, mask: Path | None, report: Report) -> Located | None:
    """The camera of a photo file, whose look this is; None if too little of it agrees with any picture of the scene.

    mask: a picture, white where the photo is to be used. Raises BadInput for a photo that cannot be read, or that its
    mask hides altogether.
    """
    size = probe(path).displayed
    photo, lens = Photo.from_outside(path, _camera_of_size(*size), mask), pinhole_of(path, *size)
    baked = bake(trained, look)
    cameras = [trained.camera(each) for each in spread_over(trained.collection.split("train"), VIEWS)]
    with threads_for_blocks():
        coarse, fine = [_query_at(photo, lens, px) for px in COARSE_PX], _query_at(photo, lens, FINE_PX)
        candidates = _compare_all(trained, baked, cameras, coarse, report)
        likely = sorted(
            candidates, key=lambda each: -coherence(each.pairs, each.query.features, each.reference.features)
        )
        starts = list(filter(None, mapped_in_parallel(lambda each: _solve_pose(*each), likely[:LIKELY])))
        best = None
        for start in sorted(starts, key=lambda each: -each.inliers)[:TRIES]:
            end = _iterate(trained, baked, fine, start.camera.resized(fine.lens.width, fine.lens.height))
            if end and (best is None or end.inliers > best.inliers):
                best = end
            if best and _is_reliable(best, SURE):
                break
        if best is None or not _is_reliable(best, LEAST_SHARE):
            return None
        if not _is_reliable(best, SURE):
            best = _with_other_focal_lengths(trained, baked, fine, best)
    return best._replace(camera=best.camera.resized(*size))


def _compare_all(
    trained: TrainedRun, baked: Splats, cameras: Sequence[Camera], queries: Sequence[Query], report: Report
) -> list[Candidate]:
    """The photo at each of these sizes beside what each camera sees."""

    def compare(camera: Camera) -> list[Candidate]:
        reference = _render_reference(trained, baked, camera.within(COARSE_PX[0]))
        return [Candidate(query, reference, matches(query.features, reference.features)) for query in queries]

    most = 1 if trained.device.type == "cuda" else None  # one thread at a time gives a GPU its work
    found: list[Candidate] = []
    for first in range(0, len(cameras), AT_ONCE):
        some = cameras[first : first + AT_ONCE]
        found += chain.from_iterable(mapped_in_parallel(compare, some, most))
        report.progress("Looking for its camera", first + len(some), len(cameras))
    return found


def _camera_of_size(width: int, height: int) -> Camera:
    """A camera that takes pictures of this size, of which nothing else is known."""
    return Camera.centred(np.eye(3), np.zeros(3), max(width, height), width, height)


def _is_reliable(found: Located, least_share: float) -> bool:
    """Whether at least this share of the matches agrees, and enough of them: the more, the smaller the share."""
    share = found.inliers / found.matches
    return share >= least_share and share * found.inliers >= LEAST_INLIERS


def _iterate(trained: TrainedRun, baked: Splats, query: Query, camera: Camera) -> Located | None:
    """The pose that iterating from this camera converges to: render, match and solve, while that adds inliers."""
    best, in_vain = None, 0
    for _ in range(ROUNDS):
        reference = _render_reference(trained, baked, camera)
        pairs = matches_nearby(query.features, reference.features, REACH, LEAST_ALIKE)
        found = _solve_pose(query, reference, pairs)
        if found is None:
            break
        inliers = best.inliers if best else 0
        in_vain = in_vain + 1 if found.inliers < GAIN * inliers else 0
        if found.inliers > inliers:
            best = found
        if in_vain == PATIENCE:
            break
        camera = found.camera
    return best


def _with_other_focal_lengths(trained: TrainedRun, baked: Splats, query: Query, best: Located) -> Located:
    """`best`, or what iterating finds from cameras with other focal lengths that see the place as large, if that is
    better.

    What is as deep everywhere looks the same from nearer by through a wider lens, so iterating by itself changes the
    focal length only slowly.
    """
    depth = _median_depth(trained, baked, best.camera)
    for factor in (WIDER, 1 / WIDER):
        while True:
            found = _iterate(trained, baked, query, _dollied(best.camera, depth, factor))
            if found is None or found.inliers < GAIN * best.inliers:
                break
            best, depth = found, _median_depth(trained, baked, found.camera)
    return best


def _median_depth(trained: TrainedRun, baked: Splats, camera: Camera) -> float:
    """Of the place as the camera sees it, scene units."""
    reference = _render_reference(trained, baked, camera)
    _, depths = camera.project(reference.points[reference.is_place])
    return float(np.median(depths))


def _dollied(camera: Camera, depth: float, factor: float) -> Camera:
    """The camera with its focal length times `factor`, moved along its axis so that what lies at this depth stays as
    large."""
    centre = camera.centre + (1 - factor) * depth * camera.world_to_camera[2]
    return replace(camera, fx=factor * camera.fx, fy=factor * camera.fy, centre=centre)


def _query_at(photo: Photo, lens: pycolmap.Camera, long_side_px: int) -> Query:
    """The photo at a size of which this is the longer side, or at that of the lens, its own, if it is smaller."""
    small = photo.camera.within(long_side_px)
    loaded, lens = load_photo(photo, small.width, small.height), copy(lens)
    lens.rescale(small.width, small.height)
    features = GridFeatures.of(torch.from_numpy(loaded.pixels).float() / 255)
    return Query(lens, features if loaded.valid is None else features.only(loaded.valid))


def _render_reference(trained: TrainedRun, baked: Splats, camera: Camera) -> Rendered:
    """What the camera sees of the run in a look."""
    visible = trained.rasterizer.visible(baked, camera)
    splats = baked[visible.rows]
    picture = trained.rasterizer.render(splats, camera, trained.background, known=visible.known)
    # A second picture, whose colours are the distance along the axis (for the place, none for the sky) and the place.
    axis, centre = (
        sent(torch.tensor(each, dtype=torch.float32), splats.means.device)
        for each in (camera.world_to_camera[2], camera.centre)
    )
    is_place = (visible.rows < trained.solid_count).float()
    colours = torch.stack([is_place * ((splats.means - centre) @ axis), is_place, torch.zeros_like(is_place)], dim=1)
    depths = trained.rasterizer.render(splats.with_sh(dc_of_colour(colours)[:, None]), camera, known=visible.known)
    features = GridFeatures.of(picture.cpu().clamp(0, 1))
    depth, share, _ = depths.cpu().double().numpy()[np.ix_(features.rows, features.columns)].reshape(-1, 3).T
    depth = depth / np.maximum(share, PLACE)
    slopes = (features.pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    local = np.column_stack([slopes, np.ones(len(slopes))]) * depth[:, None]
    return Rendered(features, local @ camera.world_to_camera + camera.centre, share > PLACE)


def _solve_pose(query: Query, reference: Rendered, pairs: Pairs) -> Located | None:
    """The camera on which the matches of the place agree, at the size of the query."""
    own, there, offset = (each[reference.is_place[pairs.second]] for each in pairs)
    pose = pose_of(query.features.pixels[own] + offset, reference.points[there], query.lens, GRID_PX)
    return None if pose is None else Located(pose.camera, int(pose.inliers.sum()), len(own))
