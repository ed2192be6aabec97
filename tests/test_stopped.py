"""Trainings that end early: stopped, or killed before anything was kept."""

import errno
import signal
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from core import pipeline
from core.errors import TrainingStopped, disk_full
from core.pipeline import evaluating, training
from core.rasterizer.inputs import ListsTooLarge
from core.run import checkpoint, history, run_folders
from core.training.gaussians.gaussians import Gaussians
from core.training.interrupt import HANG_UP
from core.training.rescue import saved_if_room_runs_out
from core.training.trainer import Trainer
from tests.failing import DENIED, failing
from tests.heard import Heard, StopsAtStep
from tests.small import HEIGHT, WIDTH, small_collection, small_scene, small_settings, unfinished

STEPS = 12
FULL = OSError(errno.ENOSPC, "No space left on device")  # what is said goes to a disk
CLOUD = f"point_cloud/iteration_{STEPS}/point_cloud.ply"


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """A folder of which `pipeline` reads the small collection."""
    return small_scene(tmp_path / "scene", monkeypatch)


LOW_MEMORY = "Train on smaller photos .* --max-gaussians; what is saved can be baked: wegs bake --run"
NO_ROOM = {
    "GPU": (
        torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20.00 GiB."),
        f"The memory of the GPU ran out. Saved .*{LOW_MEMORY}",
    ),
    "CPU": (MemoryError(), f"There is not enough memory. Saved .*{LOW_MEMORY}"),
    "lists": (ListsTooLarge("400 Gaussians cover 9 tiles."), f"400 Gaussians cover 9 tiles. Saved .*{LOW_MEMORY}"),
}


@pytest.mark.parametrize("where", NO_ROOM)
def test_a_checkpoint_is_saved_when_memory_runs_out(tmp_path, monkeypatch, where):
    problem, said = NO_ROOM[where]
    trainer = Trainer(small_collection(tmp_path), small_settings(steps=8, checkpoints=1), tmp_path)
    steps = trainer.train()
    next(steps)
    with monkeypatch.context() as patch, pytest.raises(TrainingStopped, match=said), saved_if_room_runs_out(trainer):
        patch.setattr(trainer.rasterizer, "render", failing(problem), raising=False)
        list(steps)
    saved = checkpoint.load(checkpoint.newest(tmp_path))
    assert saved.facts["step"] == 1
    (tmp_path / "whole").mkdir()
    whole, resumed = (
        Trainer(trainer.collection, trainer.settings, folder) for folder in (tmp_path / "whole", tmp_path)
    )
    resumed.resume(saved)
    for each in (whole, resumed):  # the step that found no room is taken when there is some
        list(each.train())
    assert all(
        torch.equal(tensor, resumed.gaussians.tensors()[name]) for name, tensor in whole.gaussians.tensors().items()
    )


@pytest.mark.parametrize("where", ["insert", "keep"])
def test_a_change_of_the_gaussians_that_found_no_room_is_made_when_there_is_some(tmp_path, monkeypatch, where):
    settings = small_settings(steps=8, checkpoints=1, densify_from=0.3, densify_until=0.6, densify_rounds=1)
    collection = small_collection(tmp_path)
    folders = [tmp_path / name for name in ("whole", "broken", "resumed")]
    for folder in folders:
        folder.mkdir()
    whole, broken, resumed = (Trainer(collection, settings, folder) for folder in folders)
    list(whole.train())
    with monkeypatch.context() as patch, pytest.raises(TrainingStopped), saved_if_room_runs_out(broken):
        patch.setattr(Gaussians, where, failing(MemoryError()))
        list(broken.train())
    resumed.resume(checkpoint.load(checkpoint.newest(broken.folder)))
    assert resumed.state.done == 2 and resumed.state.change_due
    list(resumed.train())
    assert all(
        torch.equal(tensor, resumed.gaussians.tensors()[name]) for name, tensor in whole.gaussians.tensors().items()
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is full")
def test_a_step_that_cannot_be_added_to_the_history_is_saved(scene, tmp_path):
    create = run_folders.create

    def create_on_full_disk(folder, *arguments):
        create(folder, *arguments)
        (folder / history.FILE).symlink_to("/dev/full")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_folders, "create", create_on_full_disk)
        said = "history.csv was not written. Saved at step 1, .* Free some space, then type: wegs train --resume -o"
        with pytest.raises(TrainingStopped, match=said):
            pipeline.train(scene, small_settings(steps=STEPS), tmp_path / "run")
    (tmp_path / "run" / history.FILE).unlink()
    pipeline.resume(tmp_path / "run")
    assert (tmp_path / "run" / CLOUD).is_file()


def test_a_disk_that_is_full_after_the_last_step_says_how_to_finish(scene, tmp_path, monkeypatch):
    said = "preview.png was not written. All steps are kept. Free some space, then type: wegs train --resume -o"
    for problem, words in ((disk_full("preview.png"), said), (DENIED, "Permission denied")):
        monkeypatch.setattr(training, "write_preview", failing(problem))
        with pytest.raises(type(problem), match=words):
            pipeline.train(scene, small_settings(steps=STEPS, checkpoints=1), tmp_path / words[:7])


def test_no_training_stops_for_a_preview_that_memory_has_no_room_for(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(training, "write_preview", failing(MemoryError()))
    folder = pipeline.train(scene, small_settings(steps=STEPS, checkpoints=2), tmp_path / "run", heard := Heard())
    assert heard.lines.count("! preview.png was not drawn. There is not enough memory.") == 2  # midway and at the end
    assert (folder / CLOUD).is_file() and not any("to look at" in line.lower() for line in heard.lines)


def test_a_step_whose_progress_cannot_be_printed_is_saved(scene, tmp_path):
    with pytest.raises(TrainingStopped, match="Saved at step 5, .* Free some space, then type: wegs train --resume -o"):
        pipeline.train(scene, small_settings(steps=STEPS), tmp_path / "run", StopsAtStep(5, FULL))
    heard = Heard()
    pipeline.resume(tmp_path / "run", heard)
    assert next(step for step in heard.steps if step[1] == STEPS) == (6, STEPS)


@pytest.mark.skipif(HANG_UP is None, reason="Windows has no SIGHUP")
def test_closing_the_terminal_saves_the_step_and_stops(scene, tmp_path):
    former = signal.signal(HANG_UP, signal.default_int_handler)  # not ignored, as under nohup
    try:
        with pytest.raises(KeyboardInterrupt, match="Step 5 is kept"):
            pipeline.train(scene, small_settings(steps=STEPS), tmp_path / "run", StopsAtStep(5, HANG_UP))
    finally:
        signal.signal(HANG_UP, former)
    assert checkpoint.read_facts(checkpoint.newest(tmp_path / "run"))["step"] == 5


def test_a_stop_while_kernels_are_compiled_says_how_to_go_on(scene, tmp_path, monkeypatch):
    run, settings = tmp_path / "run", small_settings(steps=STEPS, appearance="full")
    with monkeypatch.context() as patch:
        patch.setattr("core.pipeline.training.compile_kernels", failing(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt, match="No step was taken yet; go on with: wegs train --resume -o"):
            pipeline.train(scene, settings, run)
    with pytest.raises(KeyboardInterrupt, match="Step 5 is kept"):
        pipeline.resume(run, StopsAtStep(5))
    with monkeypatch.context() as patch:
        patch.setattr("core.pipeline.training.compile_kernels", failing(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt, match="Step 5 is kept; go on with: wegs train --resume -o"):
            pipeline.resume(run)
    pipeline.resume(run)
    assert (run / CLOUD).is_file()


def test_a_disk_without_room_for_kernels_says_how_to_go_on(scene, tmp_path, monkeypatch):
    monkeypatch.setattr("core.pipeline.training.compile_kernels", failing(disk_full("kernels")))
    with pytest.raises(TrainingStopped, match="Saved at step 0, .* then type: wegs train --resume -o"):
        pipeline.train(scene, small_settings(steps=STEPS, appearance="full"), tmp_path / "run")


def test_a_stop_after_the_last_step_says_how_to_finish(scene, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("core.pipeline.training.write_masks", failing(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt, match="All steps are kept; finish with: wegs train --resume -o"):
            pipeline.train(scene, small_settings(steps=STEPS), tmp_path / "run")
    assert not (tmp_path / "run" / CLOUD).exists()
    pipeline.resume(tmp_path / "run")
    assert (tmp_path / "run" / CLOUD).is_file()


def test_an_interrupted_evaluation_leaves_the_pictures_that_were_there(scene, tmp_path, monkeypatch):
    folder = pipeline.train(scene, small_settings(steps=STEPS), tmp_path / "run")
    pictures = folder / "pictures" / "half"

    def there():
        return {str(path.relative_to(folder)): path.read_bytes() for path in folder.glob("pictures/**/*.*")}

    def interrupted(*arguments):
        write_view(*arguments)
        raise KeyboardInterrupt

    def interrupt():
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(evaluating, "write_view", interrupted)
            pipeline.evaluate(folder, refine=False, keep_pictures=True)

    write_view = evaluating.write_view
    interrupt()
    assert not list(folder.glob("pictures/*"))
    pipeline.evaluate(folder, refine=False, keep_pictures=True)
    (pictures / "color" / "photo_2.png").write_bytes(b"of before")
    (pictures / "color" / "sub").mkdir()
    (pictures / "color" / "sub" / "gone.png").touch()  # a photo of an earlier evaluation
    before = there()
    interrupt()
    assert there() == before
    pipeline.evaluate(folder, refine=False, keep_pictures=True)
    assert sorted(str(path.relative_to(pictures)) for path in pictures.rglob("*.*")) == [
        *(f"{part}/photo_{number}.png" for part in ("color", "gt-color") for number in (2, 5)),
        "info.json",
    ]
    assert (pictures / "color" / "photo_2.png").read_bytes() != b"of before"


def test_results_of_an_earlier_step_are_named_when_a_run_is_resumed(scene, tmp_path):
    with pytest.raises(TrainingStopped, match="The disk is full"):
        pipeline.train(scene, small_settings(steps=STEPS), tmp_path / "run", StopsAtStep(5, FULL))
    pipeline.evaluate(tmp_path / "run", "full", refine=False)
    heard = Heard()
    pipeline.resume(tmp_path / "run", heard)
    assert (
        f"Of an earlier run or step: results_full.json. To measure again, type: wegs eval --run {tmp_path / 'run'}"
        in heard.lines
    )
    pipeline.evaluate(tmp_path / "run", "full", refine=False)
    pipeline.resume(unfinished(tmp_path / "run"), heard := Heard())
    assert not any("Of an earlier run or step" in line for line in heard.lines)


def test_a_run_killed_before_its_first_checkpoint_starts_again_with_its_own_settings(scene, tmp_path):
    (tmp_path / "masks").mkdir()
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[:, : WIDTH // 2] = 0
    assert cv2.imwrite(str(tmp_path / "masks" / "photo_0.png"), mask)
    settings = small_settings(steps=STEPS, checkpoints=1, sh_degree=-1)
    folder = pipeline.train(scene, settings, tmp_path / "run", masks=tmp_path / "masks")
    whole = (folder / CLOUD).read_bytes()
    checkpoint.newest(unfinished(folder)).unlink()
    heard = Heard()
    pipeline.resume(folder, heard)
    assert f"Going on with {folder} from step 0, with its own settings: it has no checkpoint yet" in heard.lines
    assert (
        next(step for step in heard.steps if step[1] == STEPS) == (1, STEPS) and (folder / CLOUD).read_bytes() == whole
    )
    steps = [line.split(",")[0] for line in (folder / "history.csv").read_text().splitlines()]
    assert steps == list(dict.fromkeys(steps))
