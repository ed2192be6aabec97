"""The camera of a photo, from points that it shows: which matches agree on it, and which lenses are believed."""

import numpy as np
import pycolmap
import pytest
from PIL import ExifTags, Image
from pillow_heif import from_pillow

from core.data.photos.file import ORIENTATION, probe
from core.data.sfm.pose import USUAL_FOCAL_LENGTH, pinhole_of, pose_of

FOCAL_PX = 600
OFF_PX = 4.0


def lens(focal_px: float = FOCAL_PX) -> pycolmap.Camera:
    return pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[focal_px, 320, 240])


def points_at(random: np.random.Generator, distance: float, count: int) -> np.ndarray:
    return random.uniform((-1, -1, distance), (1, 1, 1.7 * distance), (count, 3))


def seen(points: np.ndarray, focal_px: float = FOCAL_PX) -> np.ndarray:
    return points[:, :2] / points[:, 2:] * focal_px + (320, 240)


@pytest.mark.parametrize("wrong", [0, 50])
def test_the_camera_is_that_on_which_most_matches_agree(wrong):
    random = np.random.default_rng(0)
    points = points_at(random, 4, 30 + wrong)
    pixels = seen(points)
    pixels[30:] = random.uniform((0, 0), (640, 480), (wrong, 2))
    pose = pose_of(pixels, points, lens(500), OFF_PX)
    assert pose.inliers[:30].all() and pose.inliers.sum() <= 32
    assert np.abs(pose.camera.centre).max() < 0.01 and np.abs(pose.camera.world_to_camera - np.eye(3)).max() < 0.01
    assert abs(pose.camera.fx / FOCAL_PX - 1) < 0.01 and (pose.camera.width, pose.camera.height) == (640, 480)
    again = pose_of(pixels, points, lens(500), OFF_PX)
    assert again.camera.numbers() == pose.camera.numbers()


def test_matches_within_the_bound_agree():
    points = points_at(np.random.default_rng(0), 4, 60)
    pixels = seen(points)
    pixels[::6, 0] += 3
    assert [int(pose_of(pixels, points, lens(), off_px).inliers.sum()) for off_px in (1.5, 6.0)] == [50, 60]


def test_lenses_that_do_not_exist_are_not_believed():
    points = points_at(np.random.default_rng(0), 40, 80)
    for focal_px, usual in ((6000, True), (16000, False)):
        assert (pose_of(seen(points, focal_px), points, lens(focal_px), OFF_PX) is not None) == usual


def test_the_focal_length_that_a_cropped_photo_still_gives_is_not_believed():
    points = points_at(np.random.default_rng(0), 4, 80)
    given = lens(300)
    given.has_prior_focal_length = True
    pose = pose_of(seen(points), points, given, OFF_PX)
    assert pose.inliers.all() and abs(pose.camera.fx / FOCAL_PX - 1) < 0.01


@pytest.mark.parametrize("orientation", [1, 6])
def test_a_focal_length_in_exif_counts_in_photos_of_any_format(tmp_path, orientation):
    tags = Image.Exif()
    tags[ORIENTATION] = orientation
    tags.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 35
    picture, focal_lengths = Image.new("RGB", (1600, 1200)), []
    for suffix in (".jpg", ".png", ".webp", ".HEIC"):
        path = tmp_path / f"a{suffix}"
        (from_pillow(picture) if suffix == ".HEIC" else picture).save(path, exif=tags.tobytes())
        size = probe(path).displayed
        found = pinhole_of(path, *size)
        assert (found.width, found.height) == size and found.has_prior_focal_length
        focal_lengths.append(found.focal_length)
    # COLMAP goes by the diagonal of a frame of 36 x 24 mm.
    assert np.allclose(focal_lengths, 35 / np.hypot(36, 24) * 2000, rtol=1e-3, atol=0)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_photo_without_exif_has_the_usual_focal_length(tmp_path, suffix):
    Image.new("RGB", (160, 120)).save(tmp_path / f"a{suffix}")
    found = pinhole_of(tmp_path / f"a{suffix}", 160, 120)
    assert found.focal_length == USUAL_FOCAL_LENGTH * 160 and not found.has_prior_focal_length


def test_nothing_is_seen_from_nowhere():
    assert pose_of(np.zeros((0, 2)), np.zeros((0, 3)), lens(), OFF_PX) is None
