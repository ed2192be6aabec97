"""NeRF-OSR folders: the cameras of the model that they were made from, their splits and masks,
and what is wrong with them."""

import codecs
import os
import shutil

import cv2
import numpy as np
import pytest

from core.data import load_collection
from core.data.formats.nerf_osr import read_nerf_osr
from core.errors import BadInput
from tests.data.checks import notes_with
from tests.data.converted import write_nerf_osr
from tests.data.small_scene import HEIGHT, WIDTH, SmallScene

SPLITS = {"photo_0.png": "test", "photo_1.png": "train", "photo_2.png": "train", "photo_3.png": "validation"}


@pytest.fixture
def scene(tmp_path):
    return write_nerf_osr(SmallScene().write(tmp_path / "colmap"), tmp_path / "scene", SPLITS)


def used(collection):
    return {photo.name: photo.split for photo in collection.photos}


def test_cameras_are_those_of_the_model(tmp_path, scene):
    found, given = load_collection(scene), load_collection(tmp_path / "colmap")
    assert (found.kind, len(found.points)) == ("nerf-osr", 0)
    assert used(found) == {"photo_0.png": "test", "photo_1.png": "train", "photo_2.png": "train"}
    assert notes_with(found, "validation/ is not used: test/ is what is held out")
    shown = given.frame.to_world(given.points)
    for photo in found.photos:
        pixels = photo.camera.in_world(found.frame).project(shown)[0]
        assert np.abs(pixels - SmallScene().seen(int(photo.name[6]))).max() < 1e-6  # float64 through text


def test_photos_that_are_missing_are_named(scene):
    (scene / "final" / "train" / "rgb" / "photo_2.png").unlink()
    (scene / "final" / "train" / "pose" / "._photo_1.txt").touch()  # macOS
    shutil.rmtree(scene / "final" / "test" / "rgb")
    collection = load_collection(scene)
    assert used(collection) == {"photo_1.png": "train", "photo_3.png": "test"}
    for split, photo in (("train", "photo_2"), ("test", "photo_0")):
        assert notes_with(collection, f"1 photo with a pose missing in {scene / 'final' / split / 'rgb'}: {photo}"), (
            collection.notes
        )


def test_texts_as_windows_programs_save_them(scene):
    before = load_collection(scene)
    for path in (scene / "final").rglob("*.txt"):
        path.write_bytes(codecs.BOM_UTF8 + path.read_bytes().replace(b"\n", b"\r\n"))
    assert [photo.camera.numbers() for photo in load_collection(scene).photos] == [
        photo.camera.numbers() for photo in before.photos
    ]


@pytest.mark.parametrize("place", ["final_clean", "."])
def test_splits_may_lie_in_final_clean_or_in_the_scene_itself(scene, place):
    if place == ".":
        for split in set(SPLITS.values()):
            (scene / "final" / split).rename(scene / split)
    else:
        (scene / "final").rename(scene / place)
    assert len(load_collection(scene).photos) == 3


def test_validation_photos_are_held_out_where_there_are_no_test_photos(scene):
    shutil.rmtree(scene / "final" / "test")
    assert used(load_collection(scene)) == {"photo_1.png": "train", "photo_2.png": "train", "photo_3.png": "test"}
    shutil.rmtree(scene / "final" / "validation")
    collection = load_collection(scene)
    assert used(collection) == {"photo_1.png": "test", "photo_2.png": "train"} and notes_with(
        collection, "every 8th photo"
    )


def test_photos_whose_names_are_not_utf_8_are_reported_and_the_others_used(scene):
    latin = os.fsdecode(b"b\xe9")
    for part, suffix in (("rgb", ".png"), ("pose", ".txt"), ("intrinsics", ".txt")):
        folder = scene / "final" / "train" / part
        (folder / f"photo_1{suffix}").rename(folder / f"{latin}{suffix}")
    collection = load_collection(scene)
    assert "photo_1.png" not in used(collection) and notes_with(
        collection, f"whose name is not in UTF-8, not used: {latin}.png"
    )


def test_photos_of_one_name_are_told_apart_by_their_split(scene):
    for part, suffix in (("rgb", ".png"), ("pose", ".txt"), ("intrinsics", ".txt")):
        folder = scene / "final" / "test" / part
        (folder / f"photo_0{suffix}").rename(folder / f"photo_1{suffix}")
    assert used(load_collection(scene)) == {
        "test/photo_1.png": "test",
        "train/photo_1.png": "train",
        "train/photo_2.png": "train",
    }


def test_masks_belong_to_the_photo_of_their_stem_or_whole_name(scene):
    for split in ("train", "test"):
        (scene / "final" / split / "mask").mkdir()
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[:60] = 0
    for split, stem in (("train", "photo_2"), ("test", "photo_0")):
        assert cv2.imwrite(str(scene / "final" / split / "mask" / f"{stem}.jpg"), mask)
    collection = load_collection(scene)
    assert [photo.mask and photo.mask.path.name for name in ("test", "train") for photo in collection.split(name)] == [
        None,
        None,
        "photo_2.jpg",
    ]
    assert notes_with(collection, "1 photo without a mask, used whole: photo_1.png")
    (scene / "final" / "train" / "mask" / "photo_2.jpg").rename(scene / "final" / "train" / "mask" / "photo_2.png.jpg")
    assert load_collection(scene).photo("photo_2.png").mask.path.name == "photo_2.png.jpg"
    (scene / "final" / "train" / "mask" / "photo_2.png.jpg").rename(scene / "final" / "train" / "mask" / "mask_2.jpg")
    assert notes_with(
        load_collection(scene),
        f"No mask in {scene / 'final' / 'train' / 'mask'} has the name of a training photo: none is used",
    )


def test_photos_in_folders_below_are_found_with_their_cameras_and_masks(scene):
    given = load_collection(scene)
    place = scene / "final" / "train"
    cv2.imwrite(str(place / "mask.png"), np.full((HEIGHT, WIDTH), 255, np.uint8))
    for part, name in (
        ("rgb", "photo_1.png"),
        ("pose", "photo_1.txt"),
        ("intrinsics", "photo_1.txt"),
        ("mask", "photo_1.png"),
    ):
        (place / part / "noon").mkdir(parents=True)
        (place / ("mask.png" if part == "mask" else f"{part}/{name}")).rename(place / part / "noon" / name)
    found = load_collection(scene)
    assert used(found) == {"photo_0.png": "test", "noon/photo_1.png": "train", "photo_2.png": "train"}
    assert [photo.mask is not None for photo in found.split("train")] == [True, False]
    assert (found.photo("noon/photo_1.png").camera.centre == given.photo("photo_1.png").camera.centre).all()


def matrix(change):
    numbers = np.eye(4)
    change(numbers)
    return " ".join(map(str, numbers.ravel()))


@pytest.mark.parametrize(
    ("part", "text", "words"),
    [
        ("pose", None, "1 photo without a text file in pose/, not used: photo_1.png"),
        ("pose", "1 2 3", "whose text file in pose/ does not hold 16 numbers, not used: photo_1.png"),
        ("pose", "one " * 16, "whose text file in pose/ does not hold 16 numbers"),
        ("pose", matrix(lambda m: m.__setitem__((0, 3), np.nan)), "with a pose with numbers that are not finite, not used: photo_1.png"),
        ("pose", matrix(lambda m: m.__setitem__((0, 0), -1)), "with a pose that is mirrored"),
        ("pose", matrix(lambda m: m.__setitem__((0, 0), 3)), "with a pose that is not a rotation"),
        ("intrinsics", None, "without a text file in intrinsics/"),
        ("intrinsics", matrix(lambda m: m.__setitem__((0, 1), 0.5)), "with intrinsics whose skew is not 0"),
        ("intrinsics", matrix(lambda m: m.__setitem__((1, 1), -1)), "camera or pose that is broken"),
    ],
)  # fmt: skip
def test_photos_that_are_wrong_are_named_and_the_others_used(scene, part, text, words):
    path = scene / "final" / "train" / part / "photo_1.txt"
    path.unlink() if text is None else path.write_text(text)
    collection = load_collection(scene)
    assert used(collection) == {"photo_0.png": "test", "photo_2.png": "train"}
    assert notes_with(collection, words), collection.notes


def test_a_scene_without_training_photos_is_refused(scene):
    with pytest.raises(BadInput, match="has no folder train/pose any more"):
        read_nerf_osr(scene / "final" / "train")
    for path in (scene / "final" / "train" / "intrinsics").iterdir():
        path.write_text("nothing")
    with pytest.raises(
        BadInput,
        match="leaves no photo to train on: 2 photos whose text file in intrinsics/ does not hold 16 numbers, not used.* Correct",
    ):
        load_collection(scene)
    shutil.rmtree(scene / "final" / "train" / "rgb")
    with pytest.raises(BadInput, match="final/train/rgb holds no photos"):
        load_collection(scene)
