"""config.json: what made a run is read back exactly, wherever run and scene are moved."""

import codecs
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from core.data.collection import GivenMask
from core.errors import BadInput
from core.run import run_config, run_folders
from core.scene.lens import Lens
from tests.failing import DENIED, failing
from tests.small import small_settings


def test_config_gives_back_settings_and_collection_exactly(tmp_path, collection):
    settings = small_settings(sky="none", gauge=0.125)
    run_folders.create(tmp_path / "run", collection, settings)
    identity, settings_back, back = run_config.read_config(tmp_path / "run")
    assert settings_back == settings and len(identity) == 12
    assert (back.name, back.kind, back.frame.radius) == (collection.name, collection.kind, 7.0)
    np.testing.assert_array_equal(back.frame.centre, collection.frame.centre)
    for photo, expected in zip(back.photos, collection.photos, strict=True):
        assert (photo.name, photo.split, photo.lens) == (expected.name, expected.split, expected.lens)
        assert photo.path.samefile(expected.path)
        np.testing.assert_array_equal(photo.camera.world_to_camera, expected.camera.world_to_camera)
        np.testing.assert_array_equal(photo.camera.centre, expected.camera.centre)
        sizes = ("fx", "fy", "cx", "cy", "width", "height")
        assert [getattr(photo.camera, n) for n in sizes] == [getattr(expected.camera, n) for n in sizes]


def test_a_config_that_was_saved_by_an_editor_of_windows_is_read(tmp_path, collection):
    run_folders.create(tmp_path / "run", collection, small_settings())
    config = tmp_path / "run" / "config.json"
    before = run_config.read_config(tmp_path / "run").identity
    config.write_bytes(codecs.BOM_UTF8 + config.read_bytes().replace(b"\n", b"\r\n"))
    assert run_config.read_config(run_folders.find_run(tmp_path / "run")).identity == before


def test_a_run_goes_on_only_with_exactly_the_same_cameras(tmp_path, collection):
    run_folders.create(tmp_path / "run", collection, small_settings())
    before = run_config.read_config(tmp_path / "run").collection
    assert collection.changed_since(before) == []
    first = collection.photos[0]
    turned = first.camera.world_to_camera @ np.diag([-1.0, -1.0, 1.0])
    for camera in (
        replace(first.camera, fx=1.3 * first.camera.fx),
        replace(first.camera, world_to_camera=turned),
        replace(first.camera, width=7),
    ):
        other = replace(collection, photos=(replace(first, camera=camera), *collection.photos[1:]))
        assert other.changed_since(before) == [first.name]
    lens = Lens("OPENCV", 1, 1, [])
    assert replace(collection, photos=(replace(first, lens=lens), *collection.photos[1:])).changed_since(before) == [
        first.name
    ]


def test_a_scene_that_was_moved_with_its_run_is_found(tmp_path, collection):
    (tmp_path / "project" / "scene").mkdir(parents=True)
    moved = replace(collection, root=tmp_path / "project" / "scene")
    run_folders.create(tmp_path / "project" / "runs" / "a", moved, small_settings())
    (tmp_path / "project").rename(tmp_path / "elsewhere")
    assert (
        run_config.read_config(tmp_path / "elsewhere" / "runs" / "a").collection.root
        == tmp_path / "elsewhere" / "scene"
    )
    (tmp_path / "elsewhere" / "scene").rmdir()  # gone: the place it had is named
    assert run_config.read_config(tmp_path / "elsewhere" / "runs" / "a").collection.root == moved.root


def test_photos_and_masks_outside_the_scene_are_found_where_they_are(tmp_path, collection):
    """Whether they are moved together with scene and run, with or without a link in the scene, or left behind."""
    project = tmp_path / "project"
    for folder in ("scene", "pool", "masks"):
        (project / folder).mkdir(parents=True)
    (project / "scene" / "images").symlink_to("../pool")
    ways = {"photo_0.png": "scene/images", "photo_1.png": "pool"}
    photos = []
    for photo in collection.photos[:2]:
        (project / "pool" / photo.name).touch()
        (project / "masks" / photo.name).touch()
        photos.append(
            replace(photo, path=project / ways[photo.name] / photo.name, mask=GivenMask(project / "masks" / photo.name))
        )
    run_folders.create(
        project / "run", replace(collection, root=project / "scene", photos=tuple(photos)), small_settings()
    )

    def files(run):
        photos = run_config.read_config(run).collection.photos
        return [(photo.path.resolve(), photo.mask.path.resolve()) for photo in photos]

    def expected(folder):
        return [(folder / "pool" / photo.name, folder / "masks" / photo.name) for photo in photos]

    assert files(project / "run") == expected(project)
    shutil.copytree(project, tmp_path / "copied", symlinks=True)
    (project / "scene").rename(tmp_path / "away")
    assert files(tmp_path / "copied" / "run") == expected(tmp_path / "copied")  # though the first ones are still there
    (tmp_path / "away").rename(project / "scene")
    (project / "run").rename(tmp_path / "run")
    assert files(tmp_path / "run") == expected(project)
    (tmp_path / "run").rename(project / "run")
    project = project.rename(tmp_path / "elsewhere")
    assert files(project / "run") == expected(project)


def test_photos_outside_a_scene_are_found_once_the_scene_alone_was_moved(tmp_path, collection):
    for name in ("place", "pool", "far"):
        (tmp_path / name).mkdir()
    photos = tuple(replace(photo, path=tmp_path / "pool" / photo.name) for photo in collection.photos)
    for photo in photos:
        photo.path.touch()
    run_folders.create(tmp_path / "run", replace(collection, root=tmp_path / "place", photos=photos), small_settings())
    config = tmp_path / "run" / "config.json"
    facts = json.loads(config.read_text())
    facts["scene"]["path"] = str((tmp_path / "place").rename(tmp_path / "far" / "place"))  # as `scene_gone` says
    config.write_text(json.dumps(facts))
    assert [photo.path for photo in run_config.read_config(tmp_path / "run").collection.photos] == [
        p.path for p in photos
    ]


def test_a_folder_without_the_photos_is_not_the_scene_of_a_run_that_was_made_in_its_scene(tmp_path, collection):
    scene = tmp_path / "place"
    scene.mkdir()
    photos = []
    for photo in collection.photos:
        photos.append(replace(photo, path=scene / photo.name))
        photos[-1].path.touch()
    run_folders.create(scene / "runs" / "a", replace(collection, root=scene, photos=tuple(photos)), small_settings())
    now = scene.rename(tmp_path / "renamed")
    assert run_config.read_config(now / "runs" / "a").collection.root == now
    runs = (now / "runs").rename(tmp_path / "runs")  # the way to the scene, ../.., now leads to the folder above it
    assert run_config.read_config(runs / "a").collection.root == scene


def test_a_scene_on_another_drive_of_windows_has_no_way_from_its_run(tmp_path, collection, monkeypatch):
    monkeypatch.setattr(os.path, "relpath", failing(ValueError("path is on mount 'D:', start on mount 'C:'")))
    run_folders.create(tmp_path / "run", replace(collection, root=tmp_path / "scene"), small_settings())
    assert json.loads((tmp_path / "run" / "config.json").read_text())["scene"]["from_run"] is None
    # It is gone, and the run itself is none.
    assert run_config.read_config(tmp_path / "run").collection.root == tmp_path / "scene"


def test_the_identity_follows_what_decides_the_run(tmp_path, collection):
    identities = set()
    mask = tmp_path / "mask.png"
    masked = replace(collection, photos=(replace(collection.photos[0], mask=GivenMask(mask)), *collection.photos[1:]))
    for number, (scene, settings, drawn) in enumerate(
        [
            (collection, small_settings(), ""),
            (collection, small_settings(), ""),
            (collection, small_settings(seed=1), ""),
            (masked, small_settings(), "one"),
            (masked, small_settings(), "another"),
        ]
    ):
        mask.write_text(drawn)
        run_folders.create(tmp_path / str(number), scene, settings)
        identities.add(run_config.read_config(tmp_path / str(number)).identity)
    assert len(identities) == 4


def changed(camera=(), lens=()):
    def change(photo):
        photo["camera"] |= camera
        photo["lens"] = {
            "model": "SIMPLE_PINHOLE",
            "width": 4,
            "height": 3,
            "params": [4.0, 2, 1.5],
            "orientation": 1,
        } | dict(lens)

    return change


@pytest.mark.parametrize(
    "change, words",
    [
        (changed(), None),
        (changed(camera={"cx": "a"}), "as a picture of"),
        (changed(camera={"cy": float("nan")}), "as a picture of"),
        (changed(camera={"fx": -1}), "as a picture of"),
        (changed(camera={"width": 10**9}), "as a picture of"),
        (changed(camera={"width": 4.5}), "as a picture of"),
        (changed(camera={"centre": [0, float("nan"), 0]}), "from .0.0, nan, 0.0."),
        (changed(camera={"world_to_camera": np.zeros((3, 3)).tolist()}), "from .* turned by"),
        (changed(camera={"world_to_camera": (-np.eye(3)).tolist()}), "from .* turned by"),
        (changed(camera={"world_to_camera": np.full((3, 3), 1e200).tolist()}), "from .* turned by"),
        (changed(lens={"model": "ZORK"}), "through .*ZORK"),
        (changed(lens={"model": "EQUIRECTANGULAR", "params": []}), "through"),
        (changed(lens={"params": [4.0]}), "through"),
        (changed(lens={"params": [4.0, float("nan"), 1.5]}), "through"),
        (changed(lens={"width": 0}), "through"),
        (changed(lens={"orientation": 2}), "through"),
    ],
)
def test_an_impossible_camera_is_refused_and_its_photo_named(tmp_path, collection, change, words):
    run_folders.create(tmp_path, collection, small_settings())
    facts = json.loads((tmp_path / "config.json").read_text())
    change(facts["photos"][1])
    (tmp_path / "config.json").write_text(json.dumps(facts))
    if words is None:
        run_config.read_config(tmp_path)
        return
    with pytest.raises(BadInput, match=f"config.json cannot be used: .*{collection.photos[1].name} {words}"):
        run_config.read_config(tmp_path)


def test_a_config_that_may_not_be_read_is_not_called_damaged(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "read_bytes", failing(DENIED))
    with pytest.raises(PermissionError):
        run_config.read_config(tmp_path)


def test_another_run_in_the_same_folder_is_noticed(tmp_path, collection):
    run_folders.create(tmp_path, collection, small_settings())
    run_config.check_same_run(tmp_path, run_config.read_config(tmp_path).identity)
    with pytest.raises(BadInput, match="holds another run than before"):
        run_config.check_same_run(tmp_path, "other")
    (tmp_path / "config.json").unlink()
    with pytest.raises(BadInput, match="holds no run any more"):
        run_config.check_same_run(tmp_path, "other")


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"settings": {"stepz": 1}}', "[" * 100_000], ids=lambda text: text[:9]
)
def test_a_damaged_config_is_refused_in_one_line(tmp_path, text):
    (tmp_path / "config.json").write_text(text)
    with pytest.raises(BadInput, match="config.json cannot be used") as caught:
        run_config.read_config(tmp_path)
    assert "\n" not in str(caught.value)
