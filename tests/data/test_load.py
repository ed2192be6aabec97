"""What a folder holds, and what a user is told who gave another; real collections where they are at hand."""

import os
import re
from pathlib import Path, PureWindowsPath

import cv2
import numpy as np
import pytest

from core.data import find_kind, find_photos, load_collection, prepare
from core.data.load import check_cameras_unknown, scene_around
from core.data.photos.names import png_paths, relative_path
from core.data.photos.pixels import load_photo
from core.errors import BadInput
from core.pipeline import cameras
from tests.data.checks import notes_with, texts_of
from tests.data.converted import write_nerf_osr, write_nerfstudio
from tests.data.small_scene import SmallScene
from tests.failing import failing
from tests.heard import Heard
from tests.real_data import real


def save_photo(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.zeros((4, 4, 3), np.uint8))


def test_a_missing_folder_is_refused(tmp_path):
    with pytest.raises(BadInput, match="There is no folder .*nowhere"):
        load_collection(tmp_path / "nowhere")


def test_a_file_in_place_of_a_folder_is_refused(tmp_path):
    save_photo(tmp_path / "a.jpg")
    with pytest.raises(BadInput, match="a.jpg is a file"):
        load_collection(tmp_path / "a.jpg")


def test_a_folder_without_photos_is_refused(tmp_path):
    (tmp_path / "images").mkdir()
    with pytest.raises(BadInput, match="no photos and no COLMAP model"):
        load_collection(tmp_path)


def test_photos_that_cannot_be_read_are_named(tmp_path):
    for name in ("IMG_1.DNG", "IMG_2.cr3", "a.jxl", "b.GIF"):
        (tmp_path / name).write_bytes(b"x")
    with pytest.raises(BadInput, match="only .cr3, .dng, .gif, .jxl photos.* Convert"):
        load_collection(tmp_path)


@pytest.mark.parametrize("folder", [".", "images", "input", "photos"])
def test_photos_without_a_model(tmp_path, folder):
    save_photo(tmp_path / folder / "a.jpg")
    assert find_kind(tmp_path) == "photos"
    assert find_photos(tmp_path) == tmp_path / folder
    with pytest.raises(BadInput, match="no COLMAP model.* Type: wegs sfm"):
        load_collection(tmp_path)


def test_a_folder_of_videos_says_how_to_take_pictures_out_of_them(tmp_path):
    for name in ("b.MOV", "a.mp4"):
        (tmp_path / name).write_bytes(b"x")
    with pytest.raises(
        BadInput,
        match=f"{tmp_path} holds only videos. Take pictures out of it: mkdir photos; ffmpeg -i {tmp_path}/a.mp4 -vf",
    ):
        find_kind(tmp_path)
    save_photo(tmp_path / "inner" / "a.jpg")
    with pytest.raises(BadInput, match="there are photos in its folder inner"):
        find_kind(tmp_path)


def test_links_to_photos_that_are_gone_are_not_called_no_photos(tmp_path):
    (tmp_path / "a.jpg").symlink_to(tmp_path / "disk" / "a.jpg")
    with pytest.raises(BadInput, match="holds only links to photos that are gone, such as a.jpg. Connect"):
        find_kind(tmp_path)


def test_the_current_folder_is_called_by_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInput, match=f"^{re.escape(str(tmp_path))} holds no photos"):
        find_kind(Path())


def test_what_lies_around_instead_of_photos_is_named(tmp_path):
    save_photo(tmp_path / "days" / "monday" / "a.jpg")
    with pytest.raises(
        BadInput, match="days holds no photos and no COLMAP model; there are photos in its folder monday. Name that"
    ):
        find_kind(tmp_path / "days")
    with pytest.raises(BadInput, match=f"there are photos in its folder {Path('days', 'monday')}. Name that"):
        find_kind(tmp_path)
    save_photo(tmp_path / "days" / "sunday" / "a.jpg")
    save_photo(tmp_path / "days" / "sunday" / "b.jpg")
    with pytest.raises(
        BadInput,
        match="there are photos in its folders sunday, monday. Put all photos into one folder, or name one of these.",
    ):
        find_kind(tmp_path / "days")
    root = SmallScene().write(tmp_path / "archive" / "scene")
    with pytest.raises(
        BadInput, match="archive holds no photos and no COLMAP model; its folder scene is a scene. Give that folder."
    ):
        find_kind(root.parent)  # not "Name scene/images": its cameras would be found anew
    for model in (root / "sparse" / "0", root / "sparse"):
        with pytest.raises(BadInput, match="holds a COLMAP model, but not the photos.*folder above"):
            find_kind(model)


def test_pictures_of_runs_and_fades_are_no_photos(tmp_path):
    run, fade = tmp_path / "photos", tmp_path / "a-to-b"
    for path in (run / "sheet.png", run / "masks" / "a.png", fade / "sheet.png", fade / "frame_000.png"):
        save_photo(path)
    assert find_photos(tmp_path) == run
    (run / "config.json").write_text('{"wegs": "1.0"}')
    with pytest.raises(BadInput, match=f"no photos and no COLMAP model, but runs such as {run}. Give the folder"):
        find_kind(tmp_path)
    with pytest.raises(BadInput, match="photos is a run, whose pictures are not photos"):
        find_kind(run)
    (run / "config.json").write_text('{"lens": 35}')  # another program's
    assert find_photos(tmp_path) == run and find_photos(fade) == fade


@pytest.mark.parametrize("lacking", [["images.bin"], ["cameras.bin", "images.bin"]])
def test_a_model_with_files_missing_is_not_taken_for_plain_photos(tmp_path, lacking):
    root = SmallScene().write(tmp_path / "scene")
    for name in lacking:
        (root / "sparse" / "0" / name).unlink()
    with pytest.raises(BadInput, match=f"sparse/0 lacks {', '.join(lacking)}. Copy it again"):
        find_kind(root)


@pytest.mark.parametrize(
    ("mark", "kind"),
    [
        ("transforms.json", "nerfstudio"),
        ("transforms_train.json", "blender"),
        ("final/train/pose", "nerf-osr"),
        ("train/pose", "nerf-osr"),
    ],
)
def test_kinds_are_told_by_their_files(tmp_path, mark, kind):
    (tmp_path / mark).mkdir(parents=True)
    save_photo(tmp_path / "images" / "a.jpg")
    assert find_kind(tmp_path) == kind
    root = SmallScene().write(tmp_path / "scene")
    (root / mark).mkdir(parents=True)
    assert load_collection(root).kind == "colmap"  # a model beats the rest


def test_a_model_that_is_used_beside_other_cameras_says_so(tmp_path):
    root = SmallScene().write(tmp_path / "scene")
    (root / "transforms.json").write_text("{}")
    assert (
        load_collection(root).notes[0].text
        == f"{root} holds a nerfstudio scene as well; its COLMAP model {root / 'sparse/0'} is used."
    )


def test_a_stray_picture_does_not_stand_for_the_photos_in_images(tmp_path, monkeypatch):
    for name in ("map.png", "images/a.jpg", "images/b.jpg"):
        save_photo(tmp_path / name)
    assert find_photos(tmp_path) == tmp_path / "images"
    monkeypatch.setattr(prepare, "scene_of_photos", lambda photos, wanted, report: SmallScene().write(wanted))
    heard = Heard()
    prepare.prepared(tmp_path, tmp_path / "made", heard)
    assert heard.lines == [f"! 1 photo in {tmp_path} not used: {tmp_path / 'images'} holds as many or more."]
    save_photo(tmp_path / "plan.png")
    assert find_photos(tmp_path) == tmp_path


@pytest.mark.parametrize("place", ["sfm", "colmap/sparse", "distorted/sparse/0", "sparse/0_aligned"])
def test_a_model_in_an_unusual_folder_is_reported(tmp_path, monkeypatch, place):
    model = SmallScene().write(tmp_path / "scene", images="images", sparse=place) / place
    monkeypatch.setattr(prepare, "scene_of_photos", lambda photos, wanted, report: SmallScene().write(wanted))
    heard = Heard()
    prepare.prepared(tmp_path / "scene", tmp_path / "made", heard)
    assert heard.lines == [
        f"! {model} holds a COLMAP model, which is not used: move it to {tmp_path / 'scene' / 'sparse' / '0'}."
    ]


def test_photos_in_a_subfolder_that_is_not_searched_are_reported(tmp_path, monkeypatch):
    for name in ("a.jpg", "b.jpg", "day/1.jpg", "day/2.jpg", "day/3.jpg", "day/dark/1.jpg"):
        save_photo(tmp_path / "photos" / name)
    monkeypatch.setattr(prepare, "scene_of_photos", lambda photos, wanted, report: SmallScene().write(wanted))
    heard = Heard()
    prepare.prepared(tmp_path / "photos", tmp_path / "made", heard)
    day = tmp_path / "photos" / "day"
    told = f"! 4 photos in {day}, {day / 'dark'} not used: subfolders are not searched. To use them, put all photos into one folder, or give theirs."
    assert heard.lines == [told]
    monkeypatch.setattr(cameras, "reconstruct", lambda photos, output, report, lists: output)
    cameras.find_cameras(tmp_path / "photos", tmp_path / "scene", heard)
    assert heard.lines[1:] == [told, f"Next: wegs train {tmp_path / 'scene'}"]


def test_a_list_beside_plain_photos_says_what_is_held_out_also_when_it_comes_later(tmp_path, monkeypatch):
    photos, made = tmp_path / "photos", SmallScene().write(tmp_path / "runs" / "photos-scene")
    (made / "images").rename(photos)
    (made / "images").symlink_to(photos)
    monkeypatch.setattr(prepare, "scene_of_photos", lambda *_: made)

    def held_out():
        return [photo.name for photo in prepare.prepared(photos, made, Heard()).split("test")]

    (photos / "about.tsv").write_text("filename\tauthor\nphoto_0.png\tme\n")
    assert held_out() == ["photo_0.png"]  # every 8th
    for names in (["photo_1.png"], ["photo_2.png", "photo_3.png"]):
        (photos / "test.txt").write_text("\n".join(names))
        assert held_out() == names
    (photos / "test.txt").unlink()
    assert held_out() == ["photo_0.png"]
    (made / "test.txt").write_text("photo_3.png")  # the user's own
    assert held_out() == ["photo_3.png"]
    (photos / "x.tsv").write_text(
        "filename\tid\tsplit\n"
        + "".join(f"photo_{index}.png\t1\t{'test' if index == 1 else 'train'}\n" for index in range(4))
    )
    assert held_out() == ["photo_1.png"]
    (photos / "x.tsv").unlink()
    assert held_out() == ["photo_3.png"]


def test_photos_on_several_drives_of_windows_are_named_by_their_whole_paths(tmp_path, monkeypatch):
    monkeypatch.setattr(os.path, "commonpath", failing(ValueError("Paths don't have the same drive")))
    found = load_collection(write_nerfstudio(SmallScene().write(tmp_path / "colmap"), tmp_path / "scene"))
    assert [photo.name for photo in found.photos] == [photo.path.as_posix() for photo in found.photos]
    assert len({relative_path(photo.name) for photo in found.photos}) == 4


def test_cameras_that_are_known_are_not_looked_for(tmp_path):
    (tmp_path / "transforms.json").write_text("{}")
    with pytest.raises(BadInput, match="is a nerfstudio scene, which has cameras. Type: wegs train"):
        check_cameras_unknown(tmp_path)
    save_photo(tmp_path / "a.jpg")
    check_cameras_unknown(tmp_path)  # plain photos as well: their cameras may be wanted anew
    (tmp_path / "film.mp4").touch()
    for name, match in (
        ("nowhere", "There is no folder"),
        ("a.jpg", "a.jpg is a file"),
        ("film.mp4", "is a file, not a folder. .*ffmpeg"),
    ):
        with pytest.raises(BadInput, match=match):
            check_cameras_unknown(tmp_path / name)


def test_one_photo(tmp_path):
    collection = load_collection(SmallScene(names=["only.png"]).write(tmp_path / "scene"))
    assert [photo.split for photo in collection.photos] == ["train"]


@pytest.mark.parametrize(
    ("name", "kind", "train", "test", "points"),
    [
        ("kermit", "colmap", 9, 2, 650),
        ("fountain", "colmap", 9, 2, 15310),
        ("sacre_coeur", "colmap", 8, 0, 1427),
        ("statue_of_liberty", "colmap", 76, 11, 11983),
    ],
)
def test_real_collections(name, kind, train, test, points):
    collection = load_collection(real(name))
    assert collection.kind == kind and len(collection.points) == points
    assert (len(collection.split("train")), len(collection.split("test"))) == (train, test)
    # Half of the SfM points lie within radius 1 by a wide margin, and each photo sees those it should.
    assert np.quantile(np.linalg.norm(collection.points, axis=1), 0.9) < 1
    for photo in collection.photos:
        pixels, depth = photo.camera.project(collection.points[photo.points])
        margin = 0.1 * max(photo.camera.width, photo.camera.height)  # undistortion pushes border points outwards
        inside = (pixels > -margin) & (pixels < np.array([photo.camera.width, photo.camera.height]) + margin)
        assert inside.all() and (depth > 0).all()
    photo = collection.photos[0]
    loaded = load_photo(photo, photo.camera.width // 3, photo.camera.height // 3)
    assert loaded.pixels.std() > 20  # a photo, not a flat fill


def test_pictures_about_photos_have_places_of_their_own():
    places = png_paths(["a/1.jpg", "a/1.webp", "2.png", "../b/3.jpg", "../c/3.jpg", "/x/4.jpg"])
    expected = ["a/1.jpg.png", "a/1.webp.png", "2.png", "b/3.png", "c/3.png", "4.png"]
    assert [place.as_posix() for place in places.values()] == expected
    odd = png_paths(["/x/4.jpg", "/y/4.jpg", "../c/1.jpg", "c/1.jpg", "a.jpg", "a.webp", "a.jpg.png"])
    assert len(set(odd.values())) == len(odd)


def test_whole_paths_never_leave_the_folder_they_are_joined_to(monkeypatch):
    wanted = {"/x/4.jpg": "4.jpg", "../c/1.jpg": "c/1.jpg", "a\\1.jpg": "a/1.jpg"}
    assert {name: relative_path(name).as_posix() for name in wanted} == wanted
    # To which /x is not absolute, and which / leads to the root of a drive.
    monkeypatch.setattr("core.data.photos.names.Path", PureWindowsPath)
    wanted |= {"C:\\x\\4.jpg": "4.jpg", "C:4.jpg": "4.jpg"}
    assert {name: relative_path(name).as_posix() for name in wanted} == wanted


def test_a_leftover_of_a_model_hides_no_transforms(tmp_path):
    scene = write_nerfstudio(SmallScene().write(tmp_path / "colmap"), tmp_path / "scene")
    (scene / "sparse" / "0").mkdir(parents=True)
    (scene / "sparse" / "0" / "points3D.txt").write_text("# 3D point list\n")
    assert load_collection(scene).kind == "nerfstudio"


def test_nerfstudios_model_is_used_where_its_transforms_json_is_gone(tmp_path):
    root = SmallScene().write(tmp_path / "scene", sparse="colmap/sparse/0")
    assert (load_collection(root).kind, len(load_collection(root).photos)) == ("colmap", 4)
    (root / "transforms.json").write_text("{}")
    with pytest.raises(BadInput, match="transforms.json has no list of frames"):
        load_collection(root)


def test_held_out_copies_of_training_photos_are_reported(tmp_path):
    scene = write_nerfstudio(SmallScene().write(tmp_path / "colmap"), tmp_path / "scene")
    collection = load_collection(scene)
    test, train = collection.split("test")[0], collection.split("train")[0]
    assert not notes_with(collection, "copies")
    test.path.write_bytes(train.path.read_bytes())
    expected = (
        f"1 photo held out though a copy of a training photo, so figures are too good: {test.name} ({train.name})"
    )
    assert expected in texts_of(load_collection(scene).notes)


def test_copies_among_held_out_photos_are_none_of_training_photos(tmp_path):
    scene = SmallScene().write(tmp_path / "scene")
    (scene / "test.txt").write_text("photo_0.png\nphoto_1.png\n")
    (scene / "images" / "photo_1.png").write_bytes((scene / "images" / "photo_0.png").read_bytes())
    assert not notes_with(load_collection(scene), "a copy of")


def test_photos_of_a_phototourism_scene_are_pointed_to_the_folder_that_holds_its_split(tmp_path):
    root = SmallScene().write(tmp_path / "plaza", "dense/images", "dense/sparse")
    (root / "plaza.tsv").write_text("filename\tid\tsplit\n")
    assert scene_around(root / "dense" / "images") == (root, "colmap")
    other = SmallScene().write(root / "other")  # a scene of its own, that lies in another
    assert scene_around(other / "images") == (other, "colmap")


def test_a_split_of_nerf_osr_and_its_photos_are_pointed_to_the_folder_of_the_splits(tmp_path):
    splits = {f"photo_{number}.png": "test" if number == 0 else "train" for number in range(4)}
    final = write_nerf_osr(SmallScene().write(tmp_path / "colmap"), tmp_path / "scene", splits) / "final"
    save_photo(final / "train" / "mask" / "photo_1.png")
    assert scene_around(final / "train" / "rgb") == (final, "nerf-osr")
    with pytest.raises(
        BadInput,
        match=f"train holds no photos and no COLMAP model; it lies in the nerf-osr scene {final}. Give that folder",
    ):
        find_kind(final / "train")  # not "Name mask"
