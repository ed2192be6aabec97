"""Blender scenes: an angle of view and nothing else, photos without a suffix,
splits in files of their own, transparency."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from core.data import load_collection
from core.data.photos.pixels import load_photo
from core.errors import BadInput
from tests.data.checks import notes_with, texts_of
from tests.data.converted import write_blender, write_json
from tests.data.small_scene import HEIGHT, WIDTH, SmallScene


@pytest.fixture
def blender(tmp_path):
    return write_blender(SmallScene(model="SIMPLE_PINHOLE").write(tmp_path / "colmap"), tmp_path / "scene")


def test_cameras_and_splits_of_a_blender_scene_are_read(tmp_path, blender):
    collection = load_collection(blender)
    assert collection.kind == "blender"
    names = {photo.name: photo.split for photo in collection.photos}
    assert names == {"test/photo_0.png": "test", **{f"train/photo_{number}.png": "train" for number in (1, 2, 3)}}
    given = {photo.name: photo for photo in load_collection(tmp_path / "colmap").photos}
    for photo in collection.photos:
        camera, other = photo.camera.in_world(collection.frame), given[Path(photo.name).name].camera
        assert np.allclose(camera.world_to_camera, other.world_to_camera, rtol=0, atol=1e-12)
        assert np.allclose([camera.fx, camera.fy, camera.cx, camera.cy], [150, 150, 80, 60], rtol=1e-12)


def test_blenders_validation_photos_are_held_out_only_where_there_are_no_test_photos(blender):
    shutil.copy(blender / "transforms_test.json", blender / "transforms_val.json")
    assert notes_with(
        load_collection(blender), "transforms_val.json is not used: transforms_test.json is what is held out"
    )
    (blender / "transforms_test.json").unlink()
    assert splits_of(load_collection(blender)) == ["test", "train", "train", "train"]
    (blender / "transforms_val.json").unlink()
    collection = load_collection(blender)
    assert splits_of(collection) == ["test", "train", "train"] and notes_with(collection, "every 8th photo")


def splits_of(collection):
    return [photo.split for photo in collection.photos]


def test_an_empty_test_split_is_replaced_and_an_empty_training_split_refused(blender):
    write_json(blender / "transforms_test.json", {"frames": []})
    assert splits_of(load_collection(blender)) == ["test", "train", "train"]
    shutil.rmtree(blender / "train")
    with pytest.raises(
        BadInput, match="No photo of .*transforms_train.json can be used: 3 photos of transforms_train.json missing"
    ):
        load_collection(blender)
    write_json(blender / "transforms_train.json", {"frames": []})
    with pytest.raises(BadInput, match="transforms_train.json has no frames"):
        load_collection(blender)


def test_photos_in_both_files_are_held_out_and_said_so(blender):
    training = json.loads((blender / "transforms_train.json").read_text())
    held_out = json.loads((blender / "transforms_test.json").read_text())
    write_json(blender / "transforms_test.json", held_out | {"frames": held_out["frames"] + training["frames"][:1]})
    found = load_collection(blender)
    assert notes_with(found, "1 photo in both transforms_train.json and transforms_test.json, held out: ")
    assert splits_of(found).count("train") == 2
    write_json(blender / "transforms_test.json", training)
    with pytest.raises(
        BadInput,
        match="leaves no photo to train on: 3 photos in both transforms_train.json and transforms_test.json, held out.* --all-photos",
    ):
        load_collection(blender)


def test_missing_held_out_photos_are_not_put_down_to_the_training_file(blender):
    held_out = json.loads((blender / "transforms_test.json").read_text())
    for frame in held_out["frames"]:
        frame["file_path"] = "gone/" + frame["file_path"]
    write_json(blender / "transforms_test.json", held_out)
    notes = "\n".join(texts_of(load_collection(blender).notes))
    assert (
        "of transforms_train.json, transforms_test.json missing in" in notes
        and "No photo that is held out can be used" in notes
    )


def test_held_out_photos_alone_train_nothing(blender):
    shutil.rmtree(blender / "train")
    with pytest.raises(BadInput, match="leaves no photo to train on"):
        load_collection(blender)


def test_transparent_photos_are_used_where_they_are_opaque(blender):
    path = blender / "train" / "photo_1.png"
    pixels = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2BGRA)
    pixels[:, :40, 3] = 0
    assert cv2.imwrite(str(path), pixels)
    photo = load_collection(blender).photo("train/photo_1.png")
    picture = load_photo(photo, WIDTH, HEIGHT)
    assert not picture.valid[:, :40].any() and picture.valid[:, 40:].all()
