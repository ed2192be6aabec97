"""Models that are truncated or damaged are refused in one line; of several, the largest is read."""

import re
import shutil

import numpy as np
import pytest

from core.data import load_collection
from core.errors import BadInput
from tests.data.checks import check_geometry, notes_with
from tests.data.small_scene import SmallScene


@pytest.mark.parametrize("part", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_truncated_binary_models_are_refused(tmp_path, part, share):
    """pycolmap itself hangs on some of these and reads zeros from others."""
    root = SmallScene().write(tmp_path / "scene")
    path = root / "sparse" / "0" / f"{part}.bin"
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
    with pytest.raises(BadInput, match=f"{part}.bin is truncated or damaged"):
        load_collection(root)


@pytest.mark.parametrize(
    ("part", "place", "number"),
    [("cameras", 12, 99), ("cameras", 12, 2**32 - 1), ("images", 0, 2**62), ("images", 0, 1), ("points3D", 51, 2**62)],
)
def test_numbers_that_no_binary_model_holds_are_refused(tmp_path, part, place, number):
    """A camera model that does not exist, and counts of images or of a point's photos
    that are too large for the file or too small."""
    root = SmallScene().write(tmp_path / "scene")
    path = root / "sparse" / "0" / f"{part}.bin"
    data, size = path.read_bytes(), 4 if part == "cameras" else 8
    path.write_bytes(data[:place] + number.to_bytes(size, "little") + data[place + size :])
    with pytest.raises(BadInput, match=f"{part}.bin is truncated or damaged"):
        load_collection(root)


def test_a_binary_model_whose_photo_has_a_camera_that_is_nowhere_is_refused(tmp_path):
    root = SmallScene().write(tmp_path / "scene")
    path = root / "sparse" / "0" / "images.bin"
    data, camera = path.read_bytes(), 8 + 4 + 7 * 8  # after the count of images, an id and a pose
    path.write_bytes(data[:camera] + (77).to_bytes(4, "little") + data[camera + 4 :])
    with pytest.raises(BadInput, match=r"sparse/0 is not a COLMAP model that can be read \(.*77.*\). Copy the model"):
        load_collection(root)


@pytest.mark.parametrize("part", ["cameras", "images", "points3D"])
def test_damaged_text_models_are_refused(tmp_path, part):
    scene = SmallScene()
    root = scene.write(tmp_path / "scene")
    model = scene.in_text(root)
    text = (model / f"{part}.txt").read_text()
    (model / f"{part}.txt").write_text(text[: len(text) * 6 // 10])
    with pytest.raises(BadInput, match=r"(cameras|images|points3D).txt line \d+: "):
        load_collection(root)


@pytest.mark.parametrize(
    ("part", "words", "others", "fault"),
    [
        ("cameras", "PINHOLE", "PINHOLES", "line 4: there is no camera model PINHOLES"),
        ("cameras", " 63", " 63 0", "line 4: 5 parameters, not the 4 of a PINHOLE camera"),
        ("cameras", " 150 ", " 150,5 ", "line 4: parameter 1 is '150,5', not a number"),
        ("cameras", " 160", " 160.5", "line 4: WIDTH is '160.5', not a whole number"),
        ("cameras", " 160", " " + "9" * 400, f"line 4: WIDTH is '{'9' * 400}', not a whole number"),
        ("images", " 1 photo_1.png", " 59 photo_1.png", "line 7: its camera, 59, is not in cameras.txt"),
        ("images", "2 0.99", "2 nan 0.99", "line 7: QW is 'nan', not a number"),
        ("images", "3 0.99", "2 0.99", "line 9: IMAGE_ID 2 was there before"),
        ("images", " 20 \n", " x \n", "line 6: POINT3D_ID is 'x', not a whole number"),
        ("points3D", "\n3 ", "\n3 x ", "line 6: X is 'x', not a number"),
        ("points3D", " 245 7 ", " 245.5 7 ", "line 14: G is '245.5', not a whole number"),
    ],
)
def test_the_line_of_a_text_model_that_cannot_be_read_is_named(tmp_path, part, words, others, fault):
    scene = SmallScene()
    root = scene.write(tmp_path / "scene")
    path = scene.in_text(root) / f"{part}.txt"
    text = path.read_text()
    assert words in text
    path.write_text(text.replace(words, others, 1))
    with pytest.raises(BadInput, match=re.escape(f"{part}.txt {fault}. Correct it, copy")):
        load_collection(root)


@pytest.mark.parametrize("binary", [True, False])
def test_the_model_with_most_photos_is_read(tmp_path, binary):
    scene = SmallScene()
    root = scene.write(tmp_path / "scene")
    larger, smaller = scene.reconstruction(), scene.reconstruction()
    smaller.deregister_frame(smaller.images[smaller.reg_image_ids()[0]].frame_id)
    for name, model in (("0", smaller), ("1", larger)):
        folder = root / "sparse" / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        (model.write_binary if binary else model.write_text)(str(folder))
    collection = load_collection(root)
    assert len(collection.photos) == len(larger.reg_image_ids())
    assert notes_with(collection, "holds other models as well (0); 1 is used: it has most photos")


def test_in_a_workspace_the_scene_that_has_photos_is_used(tmp_path):
    """COLMAP's automatic reconstruction leaves a model without photos, and undistorted photos with a model of them."""
    scene = SmallScene()
    root = scene.write(tmp_path / "scene", images="dense/0/images", sparse="dense/0/sparse")
    other = SmallScene(offset=np.array([9.0, 0.0, 0.0])).write(tmp_path / "other")
    (other / "sparse").rename(root / "sparse")
    check_geometry(load_collection(root), scene)
    shutil.copy(other / "images" / scene.names[0], root / "preview.png")
    check_geometry(load_collection(root), scene)
    (other / "images").rename(root / "images")
    assert load_collection(root).photos[0].path.parent == root / "images"


@pytest.mark.parametrize("content", [None, b"no frames"])
def test_rigs_and_frames_that_are_older_than_the_images_are_not_read(tmp_path, content):
    """Programs made for earlier versions of COLMAP rewrite the other three files alone."""
    scene = SmallScene(offset=np.array([3.0, 0.0, 0.0]))
    root, older = scene.write(tmp_path / "scene"), SmallScene().write(tmp_path / "older")
    for name in ("rigs.bin", "frames.bin"):
        stale = root / "sparse" / "0" / name
        stale.write_bytes((older / "sparse" / "0" / name).read_bytes() if content is None else content)
    check_geometry(load_collection(root), scene)


@pytest.mark.parametrize("names", [None, ["a 0.png", "a 1.png", "a 2.png", "a 3.png"]])
def test_a_text_model_may_begin_with_the_mark_that_windows_writes(tmp_path, names):
    scene = SmallScene() if names is None else SmallScene(names=names)
    root = scene.write(tmp_path / "scene")
    for path in scene.in_text(root).glob("*.txt"):
        lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8-sig")
    check_geometry(load_collection(root), scene)
