"""Where photos from outside were taken: a view of the room corner that is not among its photos,
and pictures of other places."""

import shutil
from types import SimpleNamespace

import cv2
import numpy as np
import pycolmap
import pytest
import torch

from core.data import load_collection
from core.data.sfm import locate as locate_module
from core.data.sfm.features import DATABASE
from core.data.sfm.landmarks import landmarks_of
from core.data.sfm.locate import QUERY, Located, camera_of, locate
from core.errors import BadInput, WegsError
from core.report import Report
from tests.data.room_corner import FOCAL, HEIGHT, WIDTH, cameras, take_photo, textures, write_corner
from tests.failing import failing
from tests.heard import Heard


@pytest.fixture(scope="module")
def between(tmp_path_factory):
    """A photo from between the second and the third: its file, and its camera in the world."""
    (_, _), (_, first), (rotation, second), *_ = cameras(6)
    centre = (first + second) / 2
    path = tmp_path_factory.mktemp("outside") / "photo.png"
    assert cv2.imwrite(str(path), take_photo(rotation, centre, textures()))
    return path, rotation, centre


def test_a_photo_of_the_place_is_found_where_it_was_taken(corner, known, between):
    path, rotation, centre = between
    heard = Heard()
    found = locate(path, known, heard)
    camera = found.camera.in_world(corner.frame)
    assert (camera.width, camera.height) == (WIDTH, HEIGHT)
    # Seen: 0.02 of 5 units, 0.1 degrees and 0.3 % off; the focal length was not known.
    assert np.linalg.norm(camera.centre - centre) < 0.1
    assert np.abs(camera.world_to_camera - rotation).max() < 0.02
    assert abs(camera.fx / FOCAL - 1) < 0.03
    assert found.agreeing > 50 and found.agreeing <= found.matched
    assert heard.steps[-1] == (5, 5)  # the photos that it was matched with


def test_the_camera_does_not_depend_on_the_number_of_threads(known, between):
    found = []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        found.append(locate(between[0], known, Report()))
    assert found[0].camera.numbers() == found[1].camera.numbers() and found[0].matched == found[1].matched


def test_a_turned_and_enlarged_photo_is_located_as_it_is_displayed(corner, known, between, tmp_path):
    path, rotation, centre = between
    pixels = cv2.resize(
        cv2.rotate(cv2.imread(str(path)), cv2.ROTATE_90_CLOCKWISE),
        (2 * HEIGHT, 2 * WIDTH),
        interpolation=cv2.INTER_CUBIC,
    )
    assert cv2.imwrite(str(tmp_path / "turned.jpg"), pixels)
    camera = locate(tmp_path / "turned.jpg", known, Report()).camera.in_world(corner.frame)
    assert (camera.width, camera.height) == (2 * HEIGHT, 2 * WIDTH)
    assert np.linalg.norm(camera.centre - centre) < 0.1 and abs(camera.fx / (2 * FOCAL) - 1) < 0.03
    assert np.abs(camera.world_to_camera[0] + rotation[1]).max() < 0.02  # its right is what was up


def test_another_place_and_a_plain_wall_are_not_found(known, tmp_path):
    random = np.random.default_rng(5)
    other = cv2.resize(random.integers(0, 255, (40, 60, 3), np.uint8), (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST)
    for name, pixels in (("other.png", other), ("wall.png", np.full((HEIGHT, WIDTH, 3), 128, np.uint8))):
        assert cv2.imwrite(str(tmp_path / name), pixels)
        assert locate(tmp_path / name, known, Report()) is None


def test_no_feature_lies_where_a_mask_hides_the_photo_or_the_mirrored_one(known, between, tmp_path, monkeypatch):
    def found(work, *_):
        with pycolmap.Database.open(work / DATABASE) as database:
            keypoints.append(database.read_keypoints(database.read_image_with_name(QUERY).image_id)[:, :2].astype(int))
        return np.zeros((0, 2)), np.zeros((0, 3))

    keypoints = []
    monkeypatch.setattr(locate_module, "_matched", found)
    # The mirrored one is asked, too.
    monkeypatch.setattr(locate_module, "camera_of", lambda *_: Located(camera=None, agreeing=20, matched=40))
    white = np.tile(np.arange(WIDTH) // 16 % 2 == 0, (HEIGHT, 1))
    assert cv2.imwrite(str(tmp_path / "stripes.png"), 255 * white.astype(np.uint8))
    assert locate(between[0], known, Report(), tmp_path / "stripes.png").agreeing == 20
    for pixels, shown in zip(keypoints, (white, white[:, ::-1]), strict=True):
        column, row = pixels.T
        assert len(column) > 20 and shown[row, column].all()


def test_a_photo_of_which_its_mask_leaves_nothing_is_refused(known, between, tmp_path):
    """And no other photo is located in its place."""
    assert cv2.imwrite(str(tmp_path / "mask.png"), np.zeros((HEIGHT, WIDTH), np.uint8))
    with pytest.raises(BadInput, match="0.0% of its pixels by its mask"):
        locate(between[0], known, Report(), tmp_path / "mask.png")


@pytest.mark.parametrize(("true", "wrong", "agreeing"), [(11, 0, None), (12, 0, 12), (12, 60, None), (30, 50, 30)])
def test_a_camera_needs_twelve_matches_that_agree_and_a_third_of_all(true, wrong, agreeing):
    random = np.random.default_rng(0)
    points = random.uniform((-1, -1, 4), (1, 1, 7), (true + wrong, 3))
    pixels = points[:, :2] / points[:, 2:] * 600 + (320, 240)
    pixels[true:] = random.uniform((0, 0), (640, 480), (wrong, 2))
    lens = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[600, 320, 240])
    found = camera_of(pixels, points, lens, (640, 480))
    assert (found and found.agreeing) == agreeing


def test_features_that_repeat_one_point_are_one_witness_and_lenses_that_do_not_exist_are_not_believed():
    random = np.random.default_rng(0)
    points = random.uniform((-1, -1, 4), (1, 1, 7), (10, 3))
    pixels = points[:, :2] / points[:, 2:] * 600 + (320, 240)
    lens = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[600, 320, 240])
    assert camera_of(np.tile(pixels, (3, 1)), np.tile(points, (3, 1)), lens, (640, 480)) is None
    points = random.uniform((-1, -1, 40), (1, 1, 70), (80, 3))
    for focal, usual in ((6000, True), (16000, False)):
        pixels = points[:, :2] / points[:, 2:] * focal + (320, 240)
        lens = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[focal, 320, 240])
        assert (camera_of(pixels, points, lens, (640, 480)) is not None) == usual


def test_a_mirrored_photo_is_of_another_place(known, between, tmp_path, monkeypatch):
    """Of a symmetric monument, some features of a mirrored photo would agree all the same."""
    assert cv2.imwrite(str(tmp_path / "mirrored.png"), cv2.flip(cv2.imread(str(between[0])), 1))
    by_mirror = {}

    def lenient(pixels, points, lens, size):
        found = camera_of(pixels, points, lens, size)
        by_mirror.setdefault("first", found)
        return Located(camera=None, agreeing=20, matched=40) if found is None else found

    monkeypatch.setattr(locate_module, "camera_of", lenient)
    assert locate(tmp_path / "mirrored.png", known, Report()) is None and by_mirror["first"] is None
    with monkeypatch.context() as patch:
        patch.setattr(locate_module, "SURE", 10**6)
        assert locate(between[0], known, Report()).agreeing > 50  # whose mirrored picture has less


def test_the_focal_length_that_a_cropped_photo_still_gives_is_not_believed():
    random = np.random.default_rng(0)
    points = random.uniform((-1, -1, 4), (1, 1, 7), (80, 3))
    pixels = points[:, :2] / points[:, 2:] * 600 + (320, 240)
    lens = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[300, 320, 240])
    lens.has_prior_focal_length = True
    found = camera_of(pixels, points, lens, (640, 480))
    assert found.agreeing == 80 and abs(found.camera.fx / 600 - 1) < 0.01


def test_without_points_no_photo_is_located(between, tmp_path):
    scene = shutil.copytree(between[0].parent, tmp_path / "scene")
    assert locate(between[0], landmarks_of(load_collection(write_corner(scene)), Report()), Report()) is None


@pytest.mark.parametrize(
    "free, kind, words",
    [(0, WegsError, "The disk is full: temporary files .* or set TMPDIR"), (1 << 30, RuntimeError, "factory")],
)
def test_a_full_disk_of_temporary_files_is_named_and_a_defect_is_none(
    corner, known, between, monkeypatch, free, kind, words
):
    # Its words for a full disk.
    monkeypatch.setattr(pycolmap.Database, "open", failing(RuntimeError("No registered database factory succeeded.")))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    for work in (lambda: locate(between[0], known, Report()), lambda: landmarks_of(corner, Report())):
        with pytest.raises(kind, match=words):
            work()
