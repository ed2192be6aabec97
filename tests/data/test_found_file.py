"""Photos under other names than their model gives: found where no other can be meant, and said so."""

import shutil
from pathlib import Path

import pytest

from core.data import found_file, load_collection
from tests.data.checks import check_geometry, notes_with
from tests.data.converted import changed, write_nerfstudio
from tests.data.small_scene import SmallScene


def renamed(tmp_path, names):
    """A scene whose model calls its photos by `names`, and whose files are photo_0.png to photo_3.png."""
    root = SmallScene().write(tmp_path / "scene")
    scene = SmallScene(names=names)
    scene.reconstruction().write_binary(str(root / "sparse" / "0"))
    return root, scene


@pytest.mark.parametrize(
    "name",
    [
        "photo_{}",
        "Photo_{}.PNG",
        "photo_{}.jpg",
        "/home/me/photos/photo_{}.png",
        "C:\\photos\\photo_{}.png",
        "left/photo_{}.JPG",
    ],
)
def test_other_suffixes_capitals_and_folders(tmp_path, name):
    root, scene = renamed(tmp_path, [name.format(index) for index in range(4)])
    collection = load_collection(root)
    check_geometry(collection, scene)
    place = "images/" * ("/" in name)  # where the model names another folder
    assert notes_with(
        collection, f"4 photos found under another name or in another folder: {name.format(0)} ({place}photo_0.png), "
    )
    assert not notes_with(collection, "without a pose")
    (root / "images").rename(root / "images_4")
    assert len(load_collection(root).photos) == 4


def test_folders_of_windows(tmp_path):
    names = ["left\\photo_0.png", "left\\photo_1.png", "right\\photo_0.png", "photo_3.png"]
    root, _ = renamed(tmp_path, names)
    for index, name in enumerate(names):
        path = root / "images" / name.replace("\\", "/")
        path.parent.mkdir(exist_ok=True)
        (root / "images" / f"photo_{index}.png").rename(path)
    found = {photo.name: photo.path.relative_to(root / "images").as_posix() for photo in load_collection(root).photos}
    assert found == {name: name.replace("\\", "/") for name in names}


def test_forms_of_unicode(tmp_path):
    root, _ = renamed(tmp_path, ["Pl\u00e4tze.png", *(f"photo_{index}.png" for index in (1, 2, 3))])
    (root / "images" / "photo_0.png").rename(root / "images" / "Pla\u0308tze.png")
    assert len(load_collection(root).photos) == 4


def test_a_file_that_more_than_one_photo_may_mean_is_none_of_them(tmp_path):
    root, _ = renamed(tmp_path, ["left/photo_0.png", "right/photo_0.png", "photo_1.png", "photo_1.jpg"])
    shutil.copy(root / "images" / "photo_2.png", root / "images" / "photo_3.jpg")
    collection = load_collection(root)
    assert [photo.name for photo in collection.photos] == ["photo_1.png"]
    assert notes_with(collection, "3 photos of the model missing")


@pytest.mark.parametrize("folder", ["input", "photos"])
def test_other_folders_of_photos(tmp_path, folder):
    root = SmallScene().write(tmp_path / "scene", folder)
    check_geometry(load_collection(root), SmallScene())
    assert notes_with(load_collection(root), "which are right unless it is one of undistorted photos")
    (root / "dense").mkdir()
    shutil.copytree(root / folder, root / "dense" / "images")
    (root / "dense" / "images" / "photo_0.png").unlink()
    (root / "sparse").rename(root / "dense" / "sparse")  # the originals' names are no sign that they are meant
    collection = load_collection(root)
    assert {photo.path.parent for photo in collection.photos} == {root / "dense" / "images"} and len(
        collection.photos
    ) == 3


@pytest.mark.parametrize(
    "before, folder, shown", [("/home/me/images/", "images", "scene/images"), ("images/", "images_4", "images_4")]
)
def test_photos_of_several_cameras_with_equal_names(tmp_path, before, folder, shown):
    scene = write_nerfstudio(SmallScene().write(tmp_path / "colmap"), tmp_path / "scene")
    names = "left/0.png", "left/1.png", "right/0.png", "right/1.png"
    for number, name in enumerate(names):
        (scene / folder / name).parent.mkdir(parents=True, exist_ok=True)
        (scene / "images" / f"photo_{number}.png").rename(scene / folder / name)

    def change(facts):
        for frame, name in zip(facts["frames"], names, strict=True):
            frame["file_path"] = before + name

    collection = load_collection(changed(scene, change))
    assert [photo.path for photo in collection.photos] == [scene / folder / name for name in names]
    assert notes_with(collection, f"left/0.png ({shown}/left/0.png), ")


@pytest.mark.parametrize(
    "missing, shown", [("/images/a.jpg", "b.jpg"), ("/x/a.jpg", "images/b.jpg"), ("/x/images/a.jpg", "/images/b.jpg")]
)
def test_a_file_is_named_with_the_folders_that_tell_it_from_the_missing_one(missing, shown):
    assert found_file.named_beside(Path("/images/b.jpg"), Path(missing)) == shown


def test_a_transforms_json_of_another_computer(tmp_path):
    scene = write_nerfstudio(SmallScene().write(tmp_path / "colmap"), tmp_path / "scene")

    def change(facts):
        for frame in facts["frames"]:
            frame["file_path"] = "/home/me/" + frame["file_path"].replace(".png", ".PNG")
        facts["test_filenames"] = ["/home/me/images/photo_2.PNG"]

    collection = load_collection(changed(scene, change))
    assert {photo.name: photo.path.name for photo in collection.split("test")} == {"photo_2.PNG": "photo_2.png"}
    assert len(collection.photos) == 4
