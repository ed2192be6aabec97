"""Features of photos and their matches."""

import errno

import cv2
import numpy as np
import pycolmap
import pytest

from core.data.collection import Photo
from core.data.sfm import disk_space, features
from core.data.sfm.features import DATABASE, PHOTOS, extract, match, write_pictures
from core.report import QUIET
from core.scene.camera import Camera
from tests.data.room_corner import save_corner
from tests.failing import leave_on_disk
from tests.heard import Heard

NAMES = ["000001.jpg", "000002.jpg"]


@pytest.fixture
def work(tmp_path):
    """Two photos of the room's corner."""
    save_corner(tmp_path / PHOTOS, NAMES)
    return tmp_path


def test_photos_that_cannot_be_decoded_count_as_done(work):
    camera, heard = Camera(np.eye(3), np.zeros(3), 100, 100, 40, 30, 80, 60), Heard()
    posed = [
        (Photo(path.name, path, camera, "train"), camera) for path in (work / PHOTOS / NAMES[0], work / "none.jpg")
    ]
    assert list(write_pictures(posed, work, heard)) == NAMES[:1]
    assert heard.finished == {"Photos"}


def test_a_disk_with_hardly_any_room_is_full_before_pycolmap_ends_the_program(work, monkeypatch):
    with monkeypatch.context() as patch:
        leave_on_disk(disk_space.SPARE_BYTES, patch)
        with pytest.raises(OSError) as caught:
            extract(work, NAMES, QUIET)
        assert caught.value.errno == errno.ENOSPC
    extract(work, NAMES, QUIET)
    leave_on_disk(disk_space.SPARE_BYTES, monkeypatch)
    with pytest.raises(OSError) as caught:
        match(work, [tuple(NAMES)], QUIET)
    assert caught.value.errno == errno.ENOSPC


def test_no_photo_has_more_features_than_asked_for(work):
    extract(work, NAMES, QUIET, most=40)
    database = pycolmap.Database.open(str(work / DATABASE))
    # Of 1,000. COLMAP takes all of the last size of features that it begins.
    assert all(0 < database.num_keypoints_for_image(image.image_id) < 100 for image in database.read_all_images())


def test_photos_are_numbered_in_their_order_however_long_they_take(tmp_path):
    (tmp_path / PHOTOS).mkdir()
    names = [f"{number:06d}.jpg" for number in range(1, 7)]
    for number, name in enumerate(names):
        noise = np.random.default_rng(number).integers(
            0, 256, (480, 640, 3) if number % 2 == 0 else (48, 64, 3), np.uint8
        )
        assert cv2.imwrite(str(tmp_path / PHOTOS / name), noise)
    extract(tmp_path, names, QUIET, most=100)
    database = pycolmap.Database.open(str(tmp_path / DATABASE))
    assert [database.read_image_with_name(name).image_id for name in names] == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize(
    "cost_s, sizes, most",
    [
        (0.01, [8, 16, 32, 64, 80], 512),
        (1.0, [8, 8, 8], 512),
        (0.2, [8, 15, 15, 15], 512),
        (0.0, [8, 16, 32, 40, 40, 3], 40),
    ],
)
def test_parts_take_as_long_as_one_waits_for_progress(monkeypatch, cost_s, sizes, most):
    now = 0.0
    monkeypatch.setattr(features.time, "monotonic", lambda: now)
    items = [str(number) for number in range(sum(sizes))]
    met = []
    for done, part in features.in_parts(items, 8, most):
        now += cost_s * len(part)
        met.append(part)
        assert done == sum(map(len, met))
    assert [len(part) for part in met] == sizes and [item for part in met for item in part] == items
