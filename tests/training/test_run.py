"""The run folder: naming, finding, replacing, what is written before the first step, and looks kept by name."""

import json
import os
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
import plyfile
import pytest
import torch

from core.errors import BadInput, BadSetting
from core.looks import saved_look
from core.looks.trained import Appearance
from core.scene.frame import SceneFrame
from core.scene.lens import Lens
from core.training import run
from tests.small import small_collection, small_settings


@pytest.fixture
def collection(tmp_path):
    """A collection with a frame that is not the world, and a lens."""
    folder = tmp_path / "scene"
    folder.mkdir()
    made = small_collection(folder)
    lens = Lens("SIMPLE_RADIAL", 48, 36, [50.0, 24.0, 18.0, 0.1])
    photos = (replace(made.photos[0], lens=lens), *made.photos[1:])
    return replace(made, photos=photos, frame=SceneFrame(np.array([100.0, -20.0, 1 / 3]), 7.0))


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def begin(folder: Path, age_s: int = 0) -> None:
    folder.mkdir(parents=True)
    (folder / "config.json").write_text('{"wegs": "0.1.0"}')
    os.utime(folder / "config.json", (1e9 - age_s, 1e9 - age_s))


# --- naming and finding


def test_runs_of_a_scene_are_numbered(here):
    assert run.choose_folder(None, "plaza") == Path("runs/plaza")
    begin(Path("runs/plaza"))
    assert run.choose_folder(None, "plaza") == Path("runs/plaza-2")
    begin(Path("runs/plaza-2"))
    assert run.choose_folder(None, "plaza") == Path("runs/plaza-3")


def test_the_newest_run_is_the_one_begun_last(here, monkeypatch):
    begin(Path("runs/b"), age_s=0)
    begin(Path("runs/a"), age_s=5)
    begin(Path("runs/c"), age_s=5)
    Path("runs/not-a-run").mkdir()
    assert run.find_run(None) == Path("runs/b")
    assert run.find_run(Path("runs/a")) == Path("runs/a")
    monkeypatch.chdir("runs/c")
    assert run.find_run(None) == Path(".")  # inside of one


def test_no_run_and_no_such_run_are_refused(here):
    with pytest.raises(BadInput, match="no run in runs"):
        run.find_run(None)
    with pytest.raises(BadInput, match="There is no folder elsewhere"):
        run.find_run(Path("elsewhere"))
    with pytest.raises(BadInput, match=f"{here.name} is not a run"):
        run.find_run(here)


def test_an_output_that_exists_is_refused_unless_empty_or_forced(here):
    Path("empty").mkdir()
    assert run.choose_folder(Path("empty"), "plaza") == Path("empty")
    begin(Path("old"))
    with pytest.raises(BadInput, match="--force"):
        run.choose_folder(Path("old"), "plaza")
    assert run.choose_folder(Path("old"), "plaza", force=True) == Path("old")
    Path("file").write_text("")
    Path("home").mkdir()
    Path("home/thesis.txt").write_text("")
    for name in ("file", "home"):
        with pytest.raises(BadInput, match=name):
            run.choose_folder(Path(name), "plaza", force=True)


@pytest.mark.parametrize("text", ['{"learning_rate": 1}', "[1]", "", "\0"])
def test_a_folder_of_another_program_is_no_run(here, text):
    folder = Path("runs/network")
    (folder / "masks").mkdir(parents=True)
    (folder / "config.json").write_text(text)
    with pytest.raises(BadInput, match="no run"):
        run.choose_folder(folder, "plaza", force=True)
    for wanted in (None, folder):
        with pytest.raises(BadInput, match="no run|is not a run"):
            run.find_run(wanted)


@pytest.mark.parametrize("text", ["", "{", "\0"])
def test_a_run_whose_config_was_garbled_is_one_still(here, text):
    begin(Path("old"))
    Path("old/config.json").write_text(text)
    Path("old/checkpoint_000100.safetensors").write_text("")
    assert run.choose_folder(Path("old"), "plaza", force=True) == Path("old")


def test_a_run_that_cannot_be_begun_leaves_nothing(tmp_path, collection, monkeypatch):
    def full(*_):
        raise BadInput("The disk is full.")

    monkeypatch.setattr(run, "write_config", full)
    thesis = tmp_path / "there" / "thesis.txt"
    thesis.parent.mkdir()
    thesis.write_text("years")
    for folder in (tmp_path / "new", thesis.parent):
        with pytest.raises(BadInput, match="full"):
            run.create(folder, collection, small_settings())
    assert not (tmp_path / "new").exists() and list(thesis.parent.iterdir()) == [thesis]


def test_the_run_that_is_taken_when_none_is_named(here):
    assert not run.is_default(Path("runs/a"))
    begin(Path("runs/a"), age_s=5)
    begin(Path("elsewhere"))
    assert run.is_default(here / "runs" / "a") and not run.is_default(Path("elsewhere"))


@pytest.mark.parametrize("end", ["", "40,1", "40,1.0\r\n50,1.2\r\n50", "abc\r\n,\r\n\0\0"])
def test_history_forgets_what_a_killed_run_will_do_again(tmp_path, end):
    kept = "step,seconds\r\n10,0.5\r\n20,0.7\r\n"
    (tmp_path / "history.csv").write_text(kept + end, newline="")
    run.rewind_history(tmp_path, 20)
    assert (tmp_path / "history.csv").read_bytes() == kept.encode()
    run.rewind_history(tmp_path / "none", 20)  # killed before its first line


def test_replacing_a_run_deletes_what_runs_write_and_nothing_else(tmp_path, collection):
    folder = tmp_path / "run"
    (folder / "masks").mkdir(parents=True)
    for name in ("masks/a.png", "checkpoint_000100.safetensors", "results_full.json", "sheet_full.png", "dusk.ply"):
        (folder / name).write_text("old")
    run.create(folder, collection, small_settings())
    assert sorted(path.name for path in folder.iterdir()) == [
        "cameras.json", "cfg_args", "config.json", "dusk.ply", "input.ply",
    ]  # fmt: skip


# --- what is written


def test_config_gives_back_settings_and_collection_exactly(tmp_path, collection):
    settings = small_settings(sky="none", gauge=0.125)
    run.create(tmp_path / "run", collection, settings)
    identity, settings_back, back = run.read_config(tmp_path / "run")
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


def test_a_run_goes_on_with_the_very_cameras_alone(tmp_path, collection):
    run.create(tmp_path / "run", collection, small_settings())
    before = run.read_config(tmp_path / "run")[2]
    assert collection.changed_since(before) == []
    first = collection.photos[0]
    turned = first.camera.world_to_camera @ np.diag([-1.0, -1.0, 1.0])
    for camera in (replace(first.camera, fx=1.3 * first.camera.fx), replace(first.camera, world_to_camera=turned), replace(first.camera, width=7)):
        other = replace(collection, photos=(replace(first, camera=camera), *collection.photos[1:]))
        assert other.changed_since(before) == [first.name]
    lens = Lens("OPENCV", 1, 1, [])
    assert replace(collection, photos=(replace(first, lens=lens), *collection.photos[1:])).changed_since(before) == [first.name]


def test_a_scene_that_was_moved_with_its_run_is_found(tmp_path, collection):
    (tmp_path / "project" / "scene").mkdir(parents=True)
    moved = replace(collection, root=tmp_path / "project" / "scene")
    run.create(tmp_path / "project" / "runs" / "a", moved, small_settings())
    (tmp_path / "project").rename(tmp_path / "elsewhere")
    assert run.read_config(tmp_path / "elsewhere" / "runs" / "a")[2].root == tmp_path / "elsewhere" / "scene"
    (tmp_path / "elsewhere" / "scene").rmdir()  # gone: the place it had is named
    assert run.read_config(tmp_path / "elsewhere" / "runs" / "a")[2].root == moved.root


def test_a_scene_on_another_drive_of_windows_has_no_way_from_its_run(tmp_path, collection, monkeypatch):
    def relpath(*_):
        raise ValueError("path is on mount 'D:', start on mount 'C:'")

    monkeypatch.setattr(os.path, "relpath", relpath)
    run.create(tmp_path / "run", replace(collection, root=tmp_path / "scene"), small_settings())
    assert json.loads((tmp_path / "run" / "config.json").read_text())["scene"]["from_run"] is None
    assert run.read_config(tmp_path / "run")[2].root == tmp_path / "scene"  # is gone, and the run itself is none


def test_the_identity_follows_what_decides_the_run(tmp_path, collection):
    identities = set()
    for number, settings in enumerate((small_settings(), small_settings(), small_settings(seed=1))):
        run.create(tmp_path / str(number), collection, settings)
        identities.add(run.read_config(tmp_path / str(number))[0])
    assert len(identities) == 2


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"settings": {"stepz": 1}}'])
def test_a_damaged_config_is_refused_in_one_line(tmp_path, text):
    (tmp_path / "config.json").write_text(text)
    with pytest.raises(BadInput, match="config.json cannot be used") as caught:
        run.read_config(tmp_path)
    assert "\n" not in str(caught.value)


def test_cameras_json_leads_back_to_the_world(tmp_path, collection):
    run.create(tmp_path / "run", collection, small_settings())
    entries = json.loads((tmp_path / "run" / "cameras.json").read_text())
    assert [entry["id"] for entry in entries] == list(range(len(collection.photos)))
    assert [entry["img_name"] for entry in entries][-2:] == ["photo_2.png", "photo_5.png"]  # test photos last
    photo = collection.photos[0]
    entry = next(entry for entry in entries if entry["img_name"] == photo.name)
    point = collection.points[0]
    from_file = np.array(entry["rotation"]).T @ (collection.frame.to_world(point) - np.array(entry["position"]))
    expected = photo.camera.world_to_camera @ (point - photo.camera.centre) * collection.frame.radius
    np.testing.assert_allclose(from_file, expected, atol=1e-12)  # float64, numbers of size 1e2
    assert (entry["fx"], entry["width"]) == (50.0, 48)


def test_cfg_args_is_the_namespace_that_viewers_expect(tmp_path, collection):
    run.create(tmp_path / "run", collection, small_settings())
    fields = eval((tmp_path / "run" / "cfg_args").read_text(), {"Namespace": Namespace})
    assert fields.source_path == str(collection.root.resolve())
    assert fields.sh_degree == 3  # our files always have 45 f_rest columns, whatever degree was trained


def test_input_ply_holds_the_points_in_world_units(tmp_path, collection):
    run.create(tmp_path / "run", collection, small_settings())
    rows = plyfile.PlyData.read(str(tmp_path / "run" / "input.ply"))["vertex"].data
    world = collection.frame.to_world(collection.points)
    np.testing.assert_array_equal(np.stack([rows[axis] for axis in "xyz"], 1), world.astype(np.float32))


# --- looks kept by name


def test_a_look_comes_back_bit_for_bit(tmp_path):
    look = Appearance("dusk", "dusk.jpg", torch.randn(16, generator=torch.Generator().manual_seed(0)))
    back = saved_look.load(saved_look.save(tmp_path, look, "abc", 7), "abc", 16, 7)
    assert torch.equal(back.embedding, look.embedding)
    assert (back.name, back.source, back.tone) == (look.name, look.source, None)
    (tmp_path / "copy.json").write_text((tmp_path / "appearance" / "dusk.json").read_text())
    assert saved_look.load(tmp_path / "copy.json", "abc", 16, 7).name == "copy"  # files are copied; what they say of themselves is no path
    night = replace(look, name="night", tone=torch.rand(2, 3))
    assert torch.equal(saved_look.load(saved_look.save(tmp_path, night, "abc", 7), "abc", 16, 7).tone, night.tone)


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "not a saved look"),
        ("{}", "not a saved look"),
        ('{"name": "a", "source": "b", "run": "other", "embedding": [1, 2]}', "saved by run other"),
        ('{"name": "a", "source": "b", "run": "abc", "step": 5, "embedding": [1, 2]}', "saved at step 5; the run is at step 7 now. Save the look again"),
        ('{"name": "a", "source": "b", "run": "abc", "embedding": [1]}', "2 finite numbers"),
        ('{"name": "a", "source": "b", "run": "abc", "embedding": [1, NaN]}', "2 finite numbers"),
        ('{"name": "a", "source": "b", "run": "abc", "embedding": [1, "x"]}', "not a saved look"),
        ('{"name": "a", "source": "b", "run": "abc", "embedding": [1, 1' + 400 * "0" + "]}", "not a saved look"),
        ('{"name": "a", "source": "b", "run": "abc", "embedding": [1, 2], "tone": [1]}', "not two rows of three gains"),
        ('{"name": "a", "source": "b", "run": "abc", "embedding": [1, 2], "tone": [[1, 1], [1, 1], [1, 1]]}', "not two rows"),
        ('{"name": "a", "source": "b", "run": "abc", "embedding": [1, 2], "tone": [[1, 1, 1], [1, 1, NaN]]}', "not two rows"),
        ('{"name": "a", "source": "b", "run": "abc", "embedding": [1, 2], "tone": [[1, 1, 1], [1, 1, -1]]}', "not two rows"),
        ('{"name": "a", "source": "b", "run": "abc", "embedding": [1, 2], "tone": [[1, 1, 1], [1, 1]]}', "not a saved look"),
    ],
)
def test_a_look_of_no_use_is_refused(tmp_path, text, words):
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(BadInput, match=words):
        saved_look.load(path, "abc", 2, 7)


def test_a_look_of_a_version_that_kept_no_step_is_read(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"name": "a", "source": "b", "run": "abc", "embedding": [1, 2]}')
    assert saved_look.load(path, "abc", 2, 7).embedding.tolist() == [1, 2]


@pytest.mark.parametrize("name", ["", ".json", "../dusk", "a/b", ".hidden", "neutral"])
def test_a_look_needs_a_plain_name(tmp_path, name):
    with pytest.raises(BadSetting):
        saved_look.path_of(tmp_path, name)


@pytest.mark.parametrize("name", ["neutral", "neutral.json"])
def test_a_look_may_not_be_called_neutral_and_is_told_why(tmp_path, name):
    with pytest.raises(BadSetting, match="every run has"):
        saved_look.path_of(tmp_path, name)


def test_a_look_may_be_named_with_its_suffix(tmp_path):
    assert saved_look.path_of(tmp_path, "dusk.json") == saved_look.path_of(tmp_path, "dusk")
