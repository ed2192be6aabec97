"""Cameras of plain photos are found once; where a model lies beside them, the user is pointed to it."""

import pytest

from core.data import prepare
from core.data.prepare import scene_of_photos
from core.data.sfm import originals
from core.system.atomic import replacing_folder, write_json
from tests.heard import Heard
from tests.small import small_collection


@pytest.fixture
def calls(monkeypatch):
    """The scenes that structure from motion was asked for; here they hold only what they were made of."""
    names = []

    def reconstruct(photos, output, report):
        names.append(output.name)
        output.mkdir(parents=True)
        write_json(output / originals.MADE_OF, originals.files_of(photos))
        return output

    monkeypatch.setattr(prepare, "reconstruct", reconstruct)
    return names


@pytest.fixture
def photos(tmp_path):
    folder = tmp_path / "scene" / "images"
    folder.mkdir(parents=True)
    small_collection(folder)
    return folder


def test_cameras_of_plain_photos_are_found_once(photos, calls, tmp_path):
    wanted = tmp_path / "runs" / "photos-scene"
    assert scene_of_photos(photos, wanted, Heard()) == wanted
    assert scene_of_photos(photos, wanted, Heard()) == wanted
    assert calls == ["photos-scene"]
    (photos / "photo_0.png").unlink()  # other photos: the scene that is there is not theirs
    heard = Heard()
    assert scene_of_photos(photos, wanted, heard).name == "photos-scene-2"
    stays = f"Of other photos, or of these before a change: {wanted}, which stays; remove it if no run needs it."
    assert heard.lines == [f"Made anew in {wanted}-2. {stays}"]
    assert scene_of_photos(photos, wanted, heard).name == "photos-scene-2"
    assert len(heard.lines) == 2 and heard.lines[1].startswith("Cameras as found before in ")
    assert calls == ["photos-scene", "photos-scene-2"]
    moved = photos.rename(tmp_path / "moved")
    assert scene_of_photos(moved, wanted, Heard()).name == "photos-scene-2"
    (moved / "photo_1.png").touch()
    assert scene_of_photos(moved, wanted, heard).name == "photos-scene-3"
    assert heard.lines[2].endswith(
        f"before a change: {wanted}, {wanted}-2, which stay; remove those that no run needs."
    )


def test_photos_that_lie_beside_a_model_are_pointed_to_it(photos, calls, tmp_path):
    heard, scene = Heard(), photos.parent
    scene_of_photos(photos, tmp_path / "a", heard)
    assert heard.lines == []
    (scene / "sparse").mkdir()
    for part in ("cameras", "images", "points3D"):
        (scene / "sparse" / f"{part}.bin").touch()
    scene_of_photos(photos, tmp_path / "b", heard)
    assert heard.lines == [
        f"! {scene} is a colmap scene: give that folder to use its cameras. Now they are found anew."
    ]


def test_parts_of_a_model_beside_photos_do_not_stop_them(photos, calls, tmp_path):
    heard = Heard()
    (photos.parent / "sparse").mkdir()
    (photos.parent / "sparse" / "cameras.bin").touch()
    scene_of_photos(photos, tmp_path / "scene", heard)
    assert heard.lines == []


def test_of_two_trainings_begun_at_once_the_slower_takes_what_the_faster_found_if_it_fits(
    photos, tmp_path, monkeypatch
):
    made_by_the_faster = {}

    def reconstruct(folder, output, report):
        with replacing_folder(output) as work:
            (work / "scene").mkdir()
            write_json(work / "scene" / originals.MADE_OF, originals.files_of(folder))
            if output in made_by_the_faster:
                output.mkdir()
                write_json(output / originals.MADE_OF, made_by_the_faster[output])

    monkeypatch.setattr(prepare, "reconstruct", reconstruct)
    same, other = tmp_path / "a", tmp_path / "b"
    made_by_the_faster |= {same: originals.files_of(photos), other: {"/other/1.jpg": [1, 2]}}
    heard = Heard()
    assert scene_of_photos(photos, same, heard) == same
    assert heard.lines[-1].startswith("Cameras as found before in ")
    assert scene_of_photos(photos, other, heard) == tmp_path / "b-2"  # those in b are of other photos
    assert heard.lines[-1].startswith(f"Made anew in {tmp_path / 'b-2'}. Of other photos, ")
