"""Which photos structure from motion uses."""

import cv2
import numpy as np
import pycolmap
import pytest

from core.data.formats.model_file import quiet
from core.data.photos.folder import list_photos
from core.data.sfm.features import DATABASE, PHOTOS, extract
from core.data.sfm.usable import LEAST_PIXELS, UsablePhoto, usable_photos
from core.errors import BadInput
from core.report import QUIET
from tests.data.small_scene import add_exif, exif_block
from tests.paths import PLAZA


def picture(seed, cells=(12, 16), size=(160, 120)):
    return cv2.resize(np.random.default_rng(seed).integers(0, 256, (*cells, 3), np.uint8), size)


def found_in(folder):
    found = dict(usable_photos(list_photos(folder), QUIET))
    used = {path.name for path, photo in found.items() if isinstance(photo, UsablePhoto)}
    return used, [photo.what for photo in found.values() if isinstance(photo, BadInput)]


@pytest.mark.parametrize(
    ("fuller", "other", "less"),
    [
        (("b.jpg", 90, (160, 120), b""), ("a.jpg", 100, (80, 60), exif_block(1)), "with fewer pixels"),
        (("b.jpg", 60, (160, 120), exif_block(1)), ("a.jpg", 100, (160, 120), b""), "without EXIF"),
        (("b.jpg", 90, (160, 120), b""), ("a.jpg", 60, (160, 120), b""), "with fewer bytes"),
    ],
)
def test_the_fullest_file_of_a_picture_is_used(tmp_path, fuller, other, less):
    for name, quality, size, exif in (fuller, other):
        assert cv2.imwrite(
            str(tmp_path / name),
            cv2.resize(picture(0), size, interpolation=cv2.INTER_AREA),
            [cv2.IMWRITE_JPEG_QUALITY, quality],
        )
        if exif:
            add_exif(tmp_path / name, exif)
    assert found_in(tmp_path) == ({fuller[0]}, [f"{other[0]} is the picture {fuller[0]} once more, {less}."])


@pytest.mark.parametrize(
    ("names", "used", "less"), [(("a1.png", "b.png"), "b.png", "a longer"), (("a.png", "b.png"), "a.png", "a later")]
)
def test_the_name_decides_between_equally_full_files(tmp_path, names, used, less):
    """Programs that copy do not shorten names. The bytes past the end of the picture differ."""
    data = cv2.imencode(".png", picture(0))[1].tobytes()
    for name in names:
        (tmp_path / name).write_bytes(data + name[:1].encode())
    (other,) = set(names) - {used}
    assert found_in(tmp_path) == ({used}, [f"{other} is the picture {used} once more, under {less} name."])


def test_the_one_with_the_shortest_name_of_equal_files_is_used_even_if_it_shows_nothing(tmp_path):
    for name in ("a (1).png", "a.png"):
        assert cv2.imwrite(str(tmp_path / name), np.zeros((120, 160, 3), np.uint8))
    assert found_in(tmp_path) == ({"a.png"}, ["a (1).png is a copy of a.png."])


@pytest.mark.parametrize(("side", "used"), [(30, {"a.png"}), (29, set())])
def test_photos_too_small_to_find_features_in_are_not_used(tmp_path, side, used):
    assert cv2.imwrite(str(tmp_path / "a.png"), picture(0, size=(40, side)))
    assert found_in(tmp_path) == (
        used,
        [f"{tmp_path / 'a.png'} is 40 x {side} px, too small to find features in."] * (not used),
    )


def features_of(photos, pixels, work):
    (work / PHOTOS).mkdir(parents=True)
    for photo in photos:
        full = cv2.imread(str(photo))
        share = np.sqrt(pixels / (full.shape[0] * full.shape[1]))
        assert cv2.imwrite(
            str(work / PHOTOS / photo.name), cv2.resize(full, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
        )
    names = [photo.name for photo in photos]
    with quiet():
        extract(work, names, QUIET)
    with pycolmap.Database.open(work / DATABASE) as database:
        return [len(database.read_keypoints(database.read_image_with_name(name).image_id)) for name in names]


def test_a_photo_too_small_has_fewer_features_than_colmap_places_it_by(tmp_path):
    photos = list_photos(PLAZA / "dense" / "images")[:12]
    needed = pycolmap.IncrementalMapperOptions().abs_pose_min_num_inliers
    assert (
        max(features_of(photos, LEAST_PIXELS, tmp_path / "small"))
        < needed
        <= min(features_of(photos, 4 * LEAST_PIXELS, tmp_path / "larger"))
    )
