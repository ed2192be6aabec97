"""The run folder: naming, finding, replacing."""

import os
import tempfile
from pathlib import Path

import pytest

from core.errors import BadInput, BadSetting
from core.run import checkpoint, run_folders
from tests.failing import DENIED, failing
from tests.small import small_settings

COPY = "checkpoint_000100 (copy).safetensors"  # that a user made


def begin(folder: Path, age_s: int = 0) -> None:
    folder.mkdir(parents=True)
    (folder / "config.json").write_text('{"wegs": "0.1.0"}')
    os.utime(folder / "config.json", (1e9 - age_s, 1e9 - age_s))


def test_runs_of_a_scene_are_numbered(here):
    assert run_folders.choose_folder(None, "plaza") == Path("runs/plaza")
    begin(Path("runs/plaza"))
    assert run_folders.choose_folder(None, "plaza") == Path("runs/plaza-2")
    begin(Path("runs/plaza-2"))
    assert run_folders.choose_folder(None, "plaza") == Path("runs/plaza-3")


def test_the_newest_run_is_the_one_begun_last(here, monkeypatch):
    begin(Path("runs/b"), age_s=0)
    begin(Path("runs/a"), age_s=5)
    begin(Path("runs/c"), age_s=5)
    Path("runs/not-a-run").mkdir()
    assert run_folders.find_run(None) == Path("runs/b")
    assert run_folders.find_run(Path("runs/a")) == Path("runs/a")
    monkeypatch.chdir("runs/c")
    assert run_folders.find_run(None) == here / "runs/c"  # inside of one, which lines name in full


def test_no_run_and_no_such_run_are_refused(here):
    with pytest.raises(BadInput, match="no run in runs"):
        run_folders.find_run(None)
    with pytest.raises(BadInput, match="There is no folder elsewhere"):
        run_folders.find_run(Path("elsewhere"))
    with pytest.raises(BadInput, match=f"{here.name} is not a run"):
        run_folders.find_run(here)
    begin(Path("runs/a"))
    with pytest.raises(BadInput, match="config.json is a file in a run. Give the folder of the run: runs/a$"):
        run_folders.find_run(Path("runs/a/config.json"))
    with pytest.raises(BadInput, match="^runs is not a run: .* Give a run in it, such as runs/a.$"):
        run_folders.find_run(Path("runs"))


def test_an_output_that_exists_is_refused_unless_empty_or_forced(here):
    Path("empty").mkdir()
    for _ in range(2):
        assert run_folders.choose_folder(Path("empty"), "plaza") == Path("empty")
        Path("empty/.config.json.wegs-killed").mkdir(exist_ok=True)  # which the next one removes
    begin(Path("old"))
    with pytest.raises(BadInput, match="--force"):
        run_folders.choose_folder(Path("old"), "plaza")
    assert run_folders.choose_folder(Path("old"), "plaza", force=True) == Path("old")
    Path("file").write_text("")
    Path("home").mkdir()
    Path("home/thesis.txt").write_text("")
    for name in ("file", "home"):
        with pytest.raises(BadInput, match=name):
            run_folders.choose_folder(Path(name), "plaza", force=True)


@pytest.mark.parametrize("output", [None, Path("new")])
def test_a_place_where_no_run_can_be_made_is_refused(output, here, monkeypatch):
    monkeypatch.setattr(tempfile, "mkdtemp", failing(DENIED))
    with pytest.raises(
        BadInput, match=f"The folder {here} may not be written in: Permission denied. Choose another -o."
    ):
        run_folders.choose_folder(output, "plaza")


def test_a_run_never_gets_a_name_that_is_not_utf_8(here):
    assert run_folders.choose_folder(None, "caf\udce9") == Path("runs/caf\ufffd")
    with pytest.raises(BadInput, match="is not in UTF-8.* Choose another -o"):
        run_folders.choose_folder(Path("caf\udce9"), "plaza")
    with pytest.raises(BadInput, match="is not in UTF-8.* Rename the folder"):
        checkpoint.load(Path("caf\udce9/checkpoint_000100.safetensors"))


def test_a_run_is_not_named_as_the_file_in_it(here):
    with pytest.raises(BadSetting, match="-o my scene.PLY: a run is a folder, with a .ply in it. Type: -o 'my scene'"):
        run_folders.choose_folder(Path("my scene.PLY"), "plaza")
    begin(Path("old.ply"))
    assert run_folders.choose_folder(Path("old.ply"), "plaza", force=True) == Path("old.ply")


@pytest.mark.parametrize("text", ['{"learning_rate": 1}', "[1]", "", "\0"])
def test_a_folder_of_another_program_is_no_run(here, text):
    folder = Path("runs/network")
    (folder / "masks").mkdir(parents=True)
    (folder / "config.json").write_text(text)
    with pytest.raises(BadInput, match="no run"):
        run_folders.choose_folder(folder, "plaza", force=True)
    for wanted in (None, folder):
        with pytest.raises(BadInput, match="no run|is not a run|is no JSON, .* If it was a run,"):
            run_folders.find_run(wanted)


@pytest.mark.parametrize("text", ["", "{", "\0"])
def test_a_run_whose_config_was_garbled_can_still_be_replaced(here, text):
    begin(Path("old"))
    Path("old/config.json").write_text(text)
    Path("old/checkpoint_000100.safetensors").write_text("")
    assert run_folders.choose_folder(Path("old"), "plaza", force=True) == Path("old")
    Path("old/config.json").write_text('{"learning_rate": 1}')  # whole, so of another program, as the checkpoint
    assert not run_folders.is_run(Path("old"))


@pytest.mark.parametrize("text", ["", '{"wegs": "0.1.0", "photos": ['])
def test_a_config_that_was_garbled_before_the_first_checkpoint_is_named(here, text):
    begin(Path("old"))
    Path("old/config.json").write_text(text)
    with pytest.raises(
        BadInput,
        match="^old/config.json is damaged: it is no JSON, and old has no checkpoint. If it was a run, train it again.$",
    ):
        run_folders.find_run(Path("old"))


def test_a_config_that_may_not_be_read_is_named(here, monkeypatch):
    begin(Path("old"))
    monkeypatch.setattr(Path, "read_bytes", failing(DENIED))
    with pytest.raises(BadInput, match=r"^old/config.json cannot be read \(Permission denied\)"):
        run_folders.find_run(Path("old"))


def test_a_run_that_cannot_be_begun_leaves_nothing(tmp_path, collection, monkeypatch):
    monkeypatch.setattr("core.run.viewer_files.write", failing(BadInput("The disk is full.")))  # after config.json
    thesis = tmp_path / "there" / "thesis.txt"
    thesis.parent.mkdir()
    thesis.write_text("years")
    for folder in (tmp_path / "new", thesis.parent):
        with pytest.raises(BadInput, match="full"):
            run_folders.create(folder, collection, small_settings())
    assert list((tmp_path / "new").iterdir()) == [] and list(thesis.parent.iterdir()) == [thesis]


def test_the_run_that_is_taken_when_none_is_named(here):
    assert not run_folders.is_default(Path("runs/a"))
    begin(Path("runs/a"), age_s=5)
    begin(Path("elsewhere"))
    assert all(map(run_folders.is_default, (here / "runs" / "a", Path("runs/a")))) and not run_folders.is_default(
        Path("elsewhere")
    )


def test_a_run_half_deleted_by_a_kill_can_still_be_replaced(tmp_path, collection, monkeypatch):
    folder, honest, left = tmp_path / "run", run_folders.remove, []
    written = ("masks", "pictures", "history.csv", "preview.png", "results.json", "checkpoint_000100.safetensors")

    def remove(path):
        if not left:
            raise KeyboardInterrupt
        left.pop()
        honest(path)

    for removed in range(len(written) + 4):
        run_folders.create(folder, collection, small_settings())
        for name in written:
            (folder / name).touch()
        left[:] = [True] * removed
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(run_folders, "remove", remove)
            run_folders.create(folder, collection, small_settings())
        assert run_folders.choose_folder(folder, "plaza", force=True) == folder


def test_replacing_a_run_deletes_what_runs_write_and_nothing_else(tmp_path, collection):
    folder = tmp_path / "run"
    (folder / "masks").mkdir(parents=True)
    for name in (
        "masks/a.png",
        "checkpoint_000100.safetensors",
        "results_full.json",
        "sheet_full.png",
        "dusk.ply",
        COPY,
    ):
        (folder / name).write_text("old")
    (folder / "pictures").symlink_to(tmp_path / "other disk")
    (tmp_path / "other disk").mkdir()
    run_folders.create(folder, collection, small_settings())
    assert (tmp_path / "other disk").is_dir()
    assert sorted(path.name for path in folder.iterdir()) == [
        "cameras.json", "cfg_args", COPY, "config.json", "dusk.ply", "input.ply",
    ]  # fmt: skip


def test_a_file_in_place_of_the_point_cloud_folder_is_refused(tmp_path):
    (tmp_path / "point_cloud").touch()
    with pytest.raises(
        BadInput,
        match="iteration_7 cannot be made: a file is in the way. Move what is there away, then type: wegs train --resume",
    ):
        run_folders.point_cloud_path(tmp_path, 7)
    (tmp_path / "point_cloud").unlink()
    for _ in range(2):  # a kill may have left the folder without the file
        assert run_folders.point_cloud_path(tmp_path, 7).parent.is_dir()
