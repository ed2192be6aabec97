"""Guided matches are those of COLMAP, which compares all descriptors of a pair."""

import shutil
from itertools import combinations

import cv2
import numpy as np
import pycolmap
import pytest

from core.data.formats.model_file import quiet
from core.data.sfm import disk_space
from core.data.sfm.features import DATABASE, LEAST_INLIERS, PHOTOS, SEED, extract, match
from core.data.sfm.guided import AT_POINTS, BYTES, LARGEST, NEAR_PX, ON_LINES, Features, guide, guided_matches
from core.report import QUIET
from tests.data.room_corner import HEIGHT, WIDTH, save_corner
from tests.failing import leave_on_disk
from tests.heard import Heard


def geometries(work):
    with pycolmap.Database.open(work / DATABASE) as database:
        numbers = [image.image_id for image in database.read_all_images()]
        return {pair: database.read_two_view_geometry(*pair) for pair in combinations(numbers, 2)}


def matches(work):
    return {pair: geometry.inlier_matches.tolist() for pair, geometry in geometries(work).items()}


@pytest.fixture(scope="module")
def verified(tmp_path_factory):
    """A work folder with photos of a corner, and one of noise, matched and verified; and the pairs.
    EXIF tells focal lengths of three of them."""
    work = tmp_path_factory.mktemp("guided")
    names = [f"{number}.png" for number in range(5)]
    save_corner(work / PHOTOS, names[:4])
    noise = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    assert cv2.imwrite(str(work / PHOTOS / names[4]), noise)
    pairs = [(second, first) for first, second in combinations(names, 2)]
    with quiet():
        extract(work, names, QUIET)
        with pycolmap.Database.open(work / DATABASE) as database:
            for camera, focal in zip(database.read_all_cameras(), (300, 400, 500), strict=False):
                camera.has_prior_focal_length, camera.params = True, [focal, *camera.params[1:]]
                database.update_camera(camera)
        match(work, pairs, QUIET)
    return work, pairs


def test_matches_are_those_of_colmap(verified, tmp_path):
    work, pairs = verified
    before = matches(work)
    ours, colmaps = tmp_path / "ours", tmp_path / "colmaps"
    for folder in (ours, colmaps):
        shutil.copytree(work, folder)
    heard = Heard()
    guide(ours, pairs, heard)
    options = pycolmap.FeatureMatchingOptions(use_gpu=False, guided_matching=True)
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = SEED
    (colmaps / "pairs.txt").write_text("\n".join(" ".join(pair) for pair in pairs))
    with pycolmap.Database.open(colmaps / DATABASE) as database:
        database.clear_two_view_geometries()  # the matches stay: COLMAP's search need not find the same ones again
    with quiet():
        pairing = pycolmap.ImportedPairingOptions(match_list_path=colmaps / "pairs.txt")
        pycolmap.match_image_pairs(colmaps / DATABASE, options, pairing, verification, pycolmap.Device.cpu)
    assert matches(ours) == matches(colmaps)
    assert {geometry.config for geometry in geometries(ours).values()} >= set(ON_LINES)
    assert sum(map(len, matches(ours).values())) > 1.1 * sum(map(len, before.values()))
    assert all(len(found) >= LEAST_INLIERS or not found for found in matches(ours).values())
    assert heard.steps[-1] == (len(pairs), len(pairs))
    once = matches(ours)
    guide(ours, pairs, QUIET)  # as a search that was stopped and goes on does
    assert matches(ours) == once


def some_features(count, seed):
    rng = np.random.default_rng(seed)
    descriptors = rng.exponential(size=(count, BYTES)) ** 2
    descriptors *= 512 / np.linalg.norm(descriptors, axis=1, keepdims=True)
    intrinsics = np.diag([80.0 + seed, 80 + seed, 1])
    return Features(
        rng.uniform(0, 100, (count, 2)).astype(np.float32), descriptors.clip(0, 255).astype(np.uint8), intrinsics
    )


def defined(first, second, matrix, at_points):
    """The definition, all with all."""
    ours, theirs = (
        np.column_stack([features.pixels.astype(float), np.ones(len(features.pixels))]) for features in (first, second)
    )
    mapped, back = ours @ matrix.T, theirs @ matrix
    if at_points:
        off = ((mapped[:, None, :2] / mapped[:, None, 2:] - theirs[None, :, :2]) ** 2).sum(axis=2)
    else:
        off = (mapped @ theirs.T) ** 2 / ((mapped[:, :2] ** 2).sum(axis=1)[:, None] + (back[:, :2] ** 2).sum(axis=1))
    distances = np.linalg.norm(first.descriptors[:, None].astype(float) - second.descriptors[None], axis=2)
    distances[off > NEAR_PX**2] = np.inf
    rivals = [
        np.sort(np.concatenate([distances, np.full_like(distances, np.inf)], axis=axis), axis=axis) for axis in (0, 1)
    ]
    clear = [distances == nearest.take([0], axis) for axis, nearest in enumerate(rivals)]
    clear += [distances < 0.8 * nearest.take([1], axis) for axis, nearest in enumerate(rivals)]
    return np.argwhere(np.logical_and.reduce([distances <= LARGEST, *clear])).tolist()


@pytest.mark.parametrize("config", ON_LINES + AT_POINTS)
@pytest.mark.parametrize("counts", [(40, 61), (64, 64), (9, 1)])
def test_matches_are_as_defined(config, counts):
    first, second = some_features(counts[0], 0), some_features(counts[1], 1)
    same = min(counts)
    rng = np.random.default_rng(2)
    # Alike.
    second.descriptors[:same] = np.clip(first.descriptors[:same] + rng.integers(-20, 21, (same, BYTES)), 0, 255)
    moved = np.array([[1.0, 0.05, 3.0], [-0.05, 1.0, -2.0], [1e-4, 0.0, 1.0]])
    where = np.column_stack([first.pixels[:same], np.ones(same)]) @ moved.T
    second.pixels[:same] = where[:, :2] / where[:, 2:] + rng.normal(0, 3, (same, 2))  # some near, some not
    epipole = np.array([[0, -1, 40], [1, 0, 300], [-40, -300, 0.0]])
    essential = second.intrinsics.T @ epipole @ moved @ first.intrinsics
    geometry = pycolmap.TwoViewGeometry(config=config, F=epipole @ moved, E=essential, H=moved)
    found = guided_matches(first, second, geometry)
    wanted = defined(first, second, moved if config in AT_POINTS else epipole @ moved, config in AT_POINTS)
    assert found.dtype == np.uint32 and found.tolist() == wanted
    assert 0 < len(wanted) < same or same == 1


def test_a_disk_with_hardly_any_room_is_reported(verified, monkeypatch):
    work, pairs = verified
    leave_on_disk(disk_space.SPARE_BYTES, monkeypatch)
    with pytest.raises(OSError, match="No space left"):
        guide(work, pairs, QUIET)


def test_no_features_match_nothing():
    none = Features(np.zeros((0, 2), np.float32), np.zeros((0, BYTES), np.uint8), np.eye(3))
    geometry = pycolmap.TwoViewGeometry(config=ON_LINES[0], E=np.eye(3))
    for first, second in ((none, some_features(3, 0)), (some_features(3, 0), none), (none, none)):
        assert guided_matches(first, second, geometry).shape == (0, 2)
