"""Which device the settings stand for, and what is said where it is not there."""

import sys
from dataclasses import replace
from subprocess import CalledProcessError
from types import SimpleNamespace

import pytest
import torch

import core.system
from core.errors import BadInput, BadSetting
from core.looks.trained import load_run
from core.pipeline import resume
from core.run import checkpoint, run_folders
from core.system import device
from core.training.trainer import Trainer
from tests.small import small_collection, small_settings
from wegs_cli.main import explain

GPU = torch.device("cuda", 0)


@pytest.fixture
def machine(monkeypatch):
    """Makes this one with or without a GPU, with or without Triton; fault: of both when they are first used."""

    def make(gpu: bool, triton: bool = True, fault: str | None = None):
        monkeypatch.setattr(torch.cuda, "is_available", lambda: gpu)
        monkeypatch.setattr(torch.cuda, "current_device", lambda: 0)
        monkeypatch.setattr(device, "find_spec", lambda name: object() if triton else None)
        monkeypatch.setattr(device, "_fault_of_first_use", lambda: fault)

    return make


def test_auto_is_the_gpu_where_one_can_be_used(machine):
    machine(gpu=True)
    assert device.chosen("auto", "auto") == device.chosen("cuda", "auto") == device.chosen("auto", "cuda") == GPU
    assert device.chosen("cpu", "auto") == device.chosen("auto", "cpu") == device.CPU
    machine(gpu=True, triton=False)
    assert device.chosen("auto", "auto") == device.CPU
    machine(gpu=False)
    assert device.chosen("auto", "auto") == device.CPU


def test_a_gpu_that_fails_when_first_used_is_none(machine):
    machine(gpu=True, fault="no C compiler")
    assert device.chosen("auto", "auto") == device.of_run("cuda") == device.CPU
    with pytest.raises(BadSetting, match="device=cuda: no C compiler. Mend that, or leave --device out"):
        device.chosen("cuda", "auto")


@pytest.fixture
def first_use(monkeypatch):
    """The fault of the first use of a GPU, tried anew: of torch, of Triton's driver and of ours, if any.
    Without a fault, nothing is found."""

    class Driver:
        active = property(lambda self: self.fails())

    def tried(torch_fails=None, triton_fails=None, ours_fails=None) -> str | None:
        def raised(problem, otherwise):
            if problem is not None:
                raise problem
            return otherwise

        monkeypatch.setattr(torch, "ones", lambda *_, **__: raised(torch_fails, torch.zeros(2)))
        Driver.fails = lambda self: raised(triton_fails, SimpleNamespace(utils=None))
        monkeypatch.setitem(sys.modules, "triton.runtime", SimpleNamespace(driver=Driver()))
        ours = SimpleNamespace(install=lambda: raised(ours_fails, None))
        monkeypatch.setattr(core.system, "triton_driver", ours, raising=False)
        return device._fault_of_first_use.__wrapped__()

    return tried


@pytest.mark.parametrize(
    "problem, told",
    [
        (RuntimeError("Failed to find C compiler. Please specify via CC."), "Failed to find C compiler"),
        (CalledProcessError(1, ["gcc", "cuda_utils.c"]), "returned non-zero exit status 1"),
        (PermissionError(13, "Permission denied", "/.triton"), "/.triton"),
        (AssertionError("libcuda.so cannot found!\nPlease make sure"), "(libcuda.so cannot found!; "),
    ],
    ids=lambda part: type(part).__name__,
)
def test_the_reasons_why_triton_cannot_be_used_are_given_with_what_it_needs(first_use, problem, told):
    assert first_use() is None
    fault = first_use(triton_fails=problem, ours_fails=OSError("libcuda.so.1: cannot open\nIt is not there"))
    assert told in fault and "libcuda.so.1: cannot open)" in fault and "gcc python3-dev" in fault and "\n" not in fault


def test_what_triton_cannot_compile_is_done_without(first_use):
    assert first_use(triton_fails=RuntimeError("Failed to find C compiler.")) is None
    fault = first_use(triton_fails=RuntimeError("Failed to find C compiler."), ours_fails=AttributeError("utils"))
    assert "(Failed to find C compiler; without that: utils)" in fault  # of a Triton that we do not know
    with pytest.raises(torch.OutOfMemoryError):
        first_use(triton_fails=RuntimeError("no"), ours_fails=torch.OutOfMemoryError("CUDA out of memory."))


def test_a_gpu_too_old_for_torch_is_reported_and_a_full_one_is_not_called_so(first_use):
    fault = first_use(
        torch_fails=RuntimeError("CUDA error: no kernel image is available for execution on the device\nSearch for ...")
    )
    assert fault.startswith(
        "torch cannot compute on this GPU (CUDA error: no kernel image is available for execution on the device), "
    )
    with pytest.raises(torch.OutOfMemoryError):
        first_use(torch_fails=torch.OutOfMemoryError("CUDA out of memory."))


def test_tensors_sent_together_are_themselves():
    tensors = [torch.rand(3), torch.rand(()), torch.rand(2, 2), torch.rand(0)]
    for ours, expected in zip(device.sent_together(tensors, device.CPU), tensors, strict=True):
        assert torch.equal(ours, expected)


def test_a_gpu_convolves_in_whole_float32(machine, monkeypatch):
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", True)
    machine(gpu=False)
    device.chosen("auto", "auto")
    assert torch.backends.cudnn.allow_tf32
    machine(gpu=True)
    device.chosen("auto", "auto")
    assert not torch.backends.cudnn.allow_tf32


def test_a_run_begun_on_a_cpu_stays_there_when_a_gpu_appears(machine, tmp_path):
    machine(gpu=False)
    collection = small_collection(tmp_path)
    settings = Trainer(collection, small_settings(device="auto"), tmp_path).settings
    machine(gpu=True)
    assert Trainer(collection, settings, tmp_path).device == device.CPU


@pytest.mark.parametrize("gpu", [False, True])
def test_a_run_of_a_gpu_does_not_go_on_where_none_can_be_used(machine, tmp_path, gpu):
    run_folders.create(tmp_path / "run", small_collection(tmp_path), small_settings(device="cuda"))
    machine(gpu=gpu, triton=False)
    with pytest.raises(
        BadInput, match="begun on a GPU, and none can be used here. Go on with it on a machine that has one"
    ):
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
        assert loaded.on_device_in_words == (", on the CPU" if place == "cuda" else "")
        if place == "cuda":
            asked = replace(loaded, settings=loaded.settings.changed(backend="cuda"))
            assert type(asked.rasterizer) is type(loaded.rasterizer)


def large(photo):
    return replace(photo, camera=photo.camera.resized(1600, 1200))


def test_out_of_memory_elsewhere_is_one_line():
    line, code = explain(torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20.00 GiB."))
    assert (code, line.split(".")[0]) == (1, "The memory of the GPU ran out")
    assert "set CUDA_VISIBLE_DEVICES=-1" in line  # which every command heeds
