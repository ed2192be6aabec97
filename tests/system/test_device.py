"""Which device the settings stand for, and what is said where it is not there."""

from dataclasses import replace

import pytest
import torch

from core.errors import BadInput, BadSetting, TrainingStopped
from core.looks.trained import load_run
from core.pipeline import resume
from core.system import device
from core.training.full_memory import saved_if_memory_runs_out
from core.training.on_disk import checkpoint, run_folders
from core.training.trainer import Trainer
from tests.small import small_collection, small_settings
from wegs_cli.main import explain

GPU = torch.device("cuda", 0)


@pytest.fixture
def machine(monkeypatch):
    """Makes this one with or without a GPU, with or without Triton."""

    def make(gpu: bool, triton: bool = True):
        monkeypatch.setattr(torch.cuda, "is_available", lambda: gpu)
        monkeypatch.setattr(torch.cuda, "current_device", lambda: 0)
        monkeypatch.setattr(device, "find_spec", lambda name: object() if triton else None)

    return make


def test_auto_is_the_gpu_where_one_can_be_used(machine):
    machine(gpu=True)
    assert device.chosen("auto", "auto") == device.chosen("cuda", "auto") == device.chosen("auto", "cuda") == GPU
    assert device.chosen("cpu", "auto") == device.chosen("auto", "cpu") == device.CPU
    machine(gpu=True, triton=False)
    assert device.chosen("auto", "auto") == device.CPU
    machine(gpu=False)
    assert device.chosen("auto", "auto") == device.CPU


def test_a_gpu_convolves_in_whole_float32(machine, monkeypatch):
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", True)
    machine(gpu=False)
    device.chosen("auto", "auto")
    assert torch.backends.cudnn.allow_tf32
    machine(gpu=True)
    device.chosen("auto", "auto")
    assert not torch.backends.cudnn.allow_tf32


def test_a_run_of_a_cpu_goes_on_there_when_a_gpu_comes(machine, tmp_path):
    machine(gpu=False)
    collection = small_collection(tmp_path)
    settings = Trainer(collection, small_settings(device="auto"), tmp_path).settings
    machine(gpu=True)
    assert Trainer(collection, settings, tmp_path).device == device.CPU


@pytest.mark.parametrize("gpu", [False, True])
def test_a_run_of_a_gpu_does_not_go_on_where_none_can_be_used(machine, tmp_path, gpu):
    run_folders.create(tmp_path / "run", small_collection(tmp_path), small_settings(device="cuda"))
    machine(gpu=gpu, triton=False)
    with pytest.raises(BadInput, match="begun on a GPU, and none can be used here. Go on with it on a machine that has one"):
        resume(tmp_path / "run")


def test_cuda_without_a_gpu_is_one_line(machine):
    machine(gpu=False)
    with pytest.raises(BadSetting, match="device=cuda: torch finds no NVIDIA GPU here. Leave --device out"):
        device.chosen("cuda", "auto")


def test_a_run_of_a_gpu_is_used_on_one_where_there_is_one(machine):
    machine(gpu=True)
    assert (device.of_run("cuda"), device.of_run("cpu"), device.of_run("auto")) == (GPU, device.CPU, device.CPU)
    machine(gpu=False)
    assert device.of_run("cuda") == device.CPU


def test_a_run_of_a_gpu_keeps_its_picture_sizes_on_a_cpu(machine, tmp_path):
    """At -r auto a photo of 1600 x 1200 is trained whole on a GPU, and at a ninth of its pixels on a CPU."""
    machine(gpu=False)
    trainer = Trainer(small_collection(tmp_path), small_settings(steps=1), tmp_path)
    list(trainer.train())
    for place, width in (("cuda", 1600), ("cpu", 516)):
        folder = tmp_path / place
        folder.mkdir()
        run_folders.create(folder, trainer.collection, trainer.settings.changed(device=place))
        (folder / "checkpoint_000001.safetensors").write_bytes(checkpoint.newest(tmp_path).read_bytes())
        loaded = load_run(folder)
        photos = tuple(large(photo) for photo in loaded.collection.photos)
        loaded = replace(loaded, collection=replace(loaded.collection, photos=photos))
        assert loaded.camera(photos[0]).width == width
        assert loaded.where == (", on the CPU" if place == "cuda" else "")
        if place == "cuda":
            asked = replace(loaded, settings=loaded.settings.changed(backend="cuda"))
            assert type(asked.rasterizer) is type(loaded.rasterizer)


def large(photo):
    return replace(photo, camera=photo.camera.resized(1600, 1200))


def test_when_the_memory_of_the_gpu_runs_out_a_checkpoint_is_kept(tmp_path, monkeypatch):
    trainer = Trainer(small_collection(tmp_path), small_settings(steps=8, checkpoints=1), tmp_path)
    steps = trainer.train()
    next(steps)

    def too_large(*_, **__):
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20.00 GiB.")

    monkeypatch.setattr(trainer.rasterizer, "render", too_large, raising=False)
    said = r"memory of the GPU ran out at step \d.*smaller photos .* --max-gaussians"
    with pytest.raises(TrainingStopped, match=said), saved_if_memory_runs_out(trainer):
        list(steps)
    assert checkpoint.newest(tmp_path) is not None


def test_out_of_memory_elsewhere_is_one_line():
    line, code = explain(torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20.00 GiB."))
    assert (code, line.split(".")[0]) == (1, "The memory of the GPU ran out")
