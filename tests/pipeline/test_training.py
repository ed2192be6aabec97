"""Train, stop and go on; and what is refused on the way."""

import gc
import shutil
import signal
from dataclasses import replace

import pytest
import torch

from core import pipeline
from core.errors import BadInput, BadSetting
from core.export.ply import read_ply
from core.looks.trained import load_run
from core.pipeline import training
from core.run import checkpoint, run_folders
from tests.failing import DENIED, failing
from tests.heard import Heard, StopsAtStep
from tests.pipeline.conftest import STEPS
from tests.small import small_settings, unfinished


def test_training_tells_what_it_found_and_leaves_a_run_that_viewers_open(trained):
    folder, heard = trained
    said = "\n".join(heard.lines)
    for words in (
        "6 photos (4 train, 2 test)",
        "! photo_7.png was dropped",
        "48x36 px",
        "held-out PSNR",
        f"To look at meanwhile: {folder / 'preview.png'}",
        "Next: wegs bake",
    ):
        assert words in said
    assert list(dict.fromkeys(done for done, total in heard.steps if total == STEPS)) == list(range(1, STEPS + 1))
    assert {"Photos", "First looks", "Masks"} <= heard.finished
    names = {path.name for path in folder.iterdir()}
    assert {"cfg_args", "cameras.json", "input.ply", "point_cloud", "config.json", "history.csv", "masks"} <= names
    neutral = read_ply(folder / "point_cloud" / f"iteration_{STEPS}" / "point_cloud.ply")
    assert 0 < len(neutral) <= len(load_run(folder).splats)
    assert len(list((folder / "masks").iterdir())) == 4


def test_ctrl_c_saves_the_step_and_the_run_is_resumed_as_if_nothing_had_happened(trained, small_scene, tmp_path):
    whole, folder = load_run(trained[0]), tmp_path / "run"
    handler = signal.getsignal(signal.SIGINT)  # a shell that starts this in the background leaves it ignored
    with pytest.raises(KeyboardInterrupt, match="Step 5 is kept.*--resume"):
        pipeline.train(small_scene, small_settings(steps=STEPS), folder, StopsAtStep(5))
    assert signal.getsignal(signal.SIGINT) is handler
    assert not (folder / "point_cloud").exists() and not (folder / "preview.png").exists()
    with (folder / "history.csv").open("a") as file:
        file.write("9,0.1,400,0.3,0.3,1.0,0.0,\n")  # as if it had gone on and then been killed
    heard = Heard()
    pipeline.resume(folder, heard)
    assert next(step for step in heard.steps if step[1] == STEPS) == (6, STEPS)
    steps = [
        [line.split(",")[0] for line in (where / "history.csv").read_text().splitlines()]
        for where in (trained[0], folder)
    ]
    assert steps[0] == steps[1]
    resumed = load_run(folder)
    for name, tensor in whole.splats.tensors().items():
        assert torch.equal(getattr(resumed.splats, name), tensor), name
    written = (folder / "history.csv").stat().st_mtime_ns
    assert pipeline.resume(folder, heard) == folder
    assert "is finished: 12 steps" in heard.lines[-2] and "--appearance PHOTO" in heard.lines[-1]
    assert (folder / "history.csv").stat().st_mtime_ns == written
    pipeline.resume(unfinished(folder))
    assert (folder / "point_cloud" / f"iteration_{STEPS}" / "point_cloud.ply").is_file()


def test_the_scene_so_far_is_shown_anew_at_every_checkpoint(small_scene, tmp_path):
    settings, shown = small_settings(steps=STEPS, checkpoints=3), set()
    for stop in (5, 9):
        with pytest.raises(KeyboardInterrupt):
            pipeline.train(small_scene, settings, tmp_path / f"run {stop}", StopsAtStep(stop))
        shown.add((tmp_path / f"run {stop}" / "preview.png").read_bytes())
    assert len(shown) == 2


def test_no_checkpoint_stays_in_memory_while_a_resumed_run_is_trained(small_scene, tmp_path, monkeypatch):
    with pytest.raises(KeyboardInterrupt):
        pipeline.train(small_scene, small_settings(steps=STEPS), tmp_path / "run", StopsAtStep(5))

    def alive() -> dict[int, checkpoint.Checkpoint]:
        return {id(one): one for one in gc.get_objects() if type(one) is checkpoint.Checkpoint}

    before, new = alive(), []  # before: what the errors of other tests hold on to
    monkeypatch.setattr(training, "_train", lambda *_: new.append(alive().keys() - before))
    pipeline.resume(tmp_path / "run")
    assert new == [set()]  # trained once


def test_a_run_killed_while_it_was_created_can_be_resumed(small_scene, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("core.run.viewer_files.write", failing(KeyboardInterrupt))
        patch.setattr(run_folders, "remove", lambda path: None)  # who is killed tidies nothing up
        pipeline.train(small_scene, small_settings(steps=STEPS), folder)
    assert [path.name for path in folder.iterdir()] == ["config.json"]
    pipeline.resume(folder)
    files = {
        "cameras.json",
        "cfg_args",
        "checkpoint_000012.safetensors",
        "config.json",
        "history.csv",
        "input.ply",
        "preview.png",
    }
    assert {path.name for path in folder.iterdir()} == files | {"masks", "point_cloud"}


def test_a_run_is_not_resumed_with_other_photos(small_scene, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    collection = training.load_collection(small_scene)
    run_folders.create(folder, collection, small_settings())
    fewer = replace(collection, photos=collection.photos[1:])
    monkeypatch.setattr(training, "load_collection", lambda *_: fewer)
    monkeypatch.setattr(checkpoint, "newest", lambda folder: folder / "checkpoint")
    monkeypatch.setattr(checkpoint, "read_facts", lambda path: {"step": 1})
    monkeypatch.setattr(training, "Trainer", None)  # which decodes them all
    with pytest.raises(
        BadInput, match="not those that .* began with; changed, split otherwise or gone: photo_0.png. Put them back"
    ):
        pipeline.resume(folder)


def test_a_run_is_not_resumed_without_a_photo_that_was_damaged_since(small_scene, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        pipeline.train(small_scene, small_settings(steps=STEPS), tmp_path / "run", StopsAtStep(5))
    photo = training.load_collection(small_scene).called("photo_1.png")
    whole = photo.path.read_bytes()
    photo.path.write_bytes(whole[:100])
    try:
        with pytest.raises(BadInput, match="changed, split otherwise or gone: photo_1.png. Put them back"):
            pipeline.resume(tmp_path / "run")
    finally:
        photo.path.write_bytes(whole)  # of the scene that all tests of this folder share


def test_a_run_that_may_not_be_written_in_is_not_resumed(trained, tmp_path, monkeypatch):
    folder = unfinished(shutil.copytree(trained[0], tmp_path / "run"))
    monkeypatch.setattr("tempfile.mkdtemp", failing(DENIED))
    monkeypatch.setattr(training, "Trainer", None)  # which decodes the photos
    with pytest.raises(
        BadInput,
        match="may not be written in: Permission denied. Make it writable, or copy the run and name the copy by -o",
    ):
        pipeline.resume(folder)


@pytest.mark.parametrize("fact", ["photos", "trainer"])
def test_a_run_whose_checkpoint_does_not_fit_is_left_as_it_is(small_scene, tmp_path, fact):
    folder, heard = tmp_path / "run", Heard()
    with pytest.raises(KeyboardInterrupt):
        pipeline.train(small_scene, small_settings(steps=STEPS), folder, StopsAtStep(5))
    saved = checkpoint.load(checkpoint.newest(folder))
    del saved.facts[fact]
    checkpoint.save(folder, saved)
    with (folder / "history.csv").open("a") as file:
        file.write("9,0.1,400,0.3,0.3,1.0,0.0,\n")  # of a step after its checkpoint
    before = (folder / "history.csv").read_bytes()
    with pytest.raises(BadInput, match=f"does not fit its run: KeyError: '{fact}'"):
        pipeline.resume(folder, heard)
    assert heard.lines == [] and (folder / "history.csv").read_bytes() == before


def test_nothing_is_written_when_training_is_refused(small_scene, tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    output = tmp_path / "run"
    refused = [({"device": "cuda"}, "finds no NVIDIA GPU"), *(({"resolution": width}, "-r 1") for width in (3, 15))]
    for changes, word in refused:
        with pytest.raises(BadSetting, match=word):
            pipeline.train(small_scene, small_settings(**changes), output)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "changes, warned",
    [({"device": "auto"}, True), ({"device": "auto", "backend": "cpu"}, False), ({"device": "cpu"}, False)],
)
def test_the_user_is_told_why_a_gpu_is_not_used(small_scene, tmp_path, monkeypatch, changes, warned):
    class Read(Exception):
        """The scene is about to be read."""

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(training.device, "fault_of_gpu", lambda: "no C compiler")
    monkeypatch.setattr(training, "prepared", failing(Read))
    heard = Heard()
    with pytest.raises(Read):
        pipeline.train(small_scene, small_settings(**changes), tmp_path / "run", heard)
    assert heard.lines == ["! The GPU is not used: no C compiler."] * warned
