"""Checkpoints: the newest is found, read back whole or refused, and none is lost to a full disk or a kill."""

import os
from pathlib import Path

import pytest
import torch
from safetensors import SafetensorError
from safetensors.torch import save_file

from core.errors import BadInput, as_out_of_memory
from core.run import checkpoint, run_folders
from core.system import lock, outputs
from tests.failing import DENIED, failing
from tests.small import small_collection, small_settings


def test_the_newest_checkpoint_is_the_one_of_the_highest_step_and_no_file_of_another_name(tmp_path):
    names = [f"checkpoint_{step}.safetensors" for step in ("000400", "999999", "1000000")]
    others = "000400 (copy).safetensors", "of_yesterday.safetensors", "99999.safetensors", "2000000.safetensors.part"
    for name in (*names, *(f"checkpoint_{other}" for other in others)):
        (tmp_path / name).touch()
    assert checkpoint.newest(tmp_path).name == names[-1] and {
        path.name for path in checkpoint.written(tmp_path)
    } == set(names)


@pytest.mark.parametrize(
    "problem, reason",
    [
        (OSError(28, "No space left on device", ".checkpoint.wegs-x"), "No space left on device"),
        (
            SafetensorError("Error while serializing: I/O error: No space left on device (os error 28)"),
            r"No space left on device \(os error 28\)",
        ),
    ],
)
def test_a_checkpoint_that_cannot_be_written_says_why_and_how_to_go_on(problem, reason, tmp_path, monkeypatch):
    saved = checkpoint.Checkpoint({"a.b": torch.arange(3)}, {"step": 7})
    checkpoint.save(tmp_path, saved)
    monkeypatch.setattr(checkpoint, "save_file", failing(problem))
    with pytest.raises(
        BadInput,
        match=f"000008.safetensors could not be written: {reason}. Free some space, or let .*, then type: wegs train --resume -o",
    ):
        checkpoint.save(tmp_path, checkpoint.Checkpoint(saved.tensors, {"step": 8}))
    checkpoint.newest(tmp_path).unlink()
    with pytest.raises(BadInput, match="then type: wegs train --resume -o"):
        checkpoint.save(tmp_path, saved)


@pytest.mark.skipif(lock.fcntl is None, reason="this system has no flock(2)")
def test_what_a_kill_left_of_a_checkpoint_goes_with_the_next_one_or_with_the_run(tmp_path):
    def killed():
        left = tmp_path / f".checkpoint{outputs.TEMPORARY}abc"
        left.mkdir()
        (left / ".tmpxyz").touch()  # safetensors' own
        os.utime(left, (1e9, 1e9))

    killed()
    path = checkpoint.save(tmp_path, checkpoint.Checkpoint({"a.b": torch.arange(3)}, {"step": 7}))
    assert list(tmp_path.iterdir()) == [path]
    killed()
    run_folders.create(tmp_path, small_collection(tmp_path / "scene"), small_settings())
    assert not [*tmp_path.glob(".*"), *tmp_path.glob("checkpoint*")]


def test_a_checkpoint_comes_back_and_a_broken_or_older_one_is_refused(tmp_path):
    saved = checkpoint.Checkpoint({"a.b": torch.arange(3)}, {"step": 7})
    path = checkpoint.save(tmp_path, saved)
    assert checkpoint.newest(tmp_path) == path
    loaded = checkpoint.load(path)
    assert torch.equal(loaded.part("a")["b"], torch.arange(3)) and loaded.facts["step"] == 7
    (tmp_path / "other").touch()
    assert path.stat().st_mode == (tmp_path / "other").stat().st_mode  # whoever may read a file may read a checkpoint
    path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(BadInput, match="not a readable checkpoint"):
        checkpoint.load(path)
    for foreign in (None, {"format": "pt"}):
        save_file(saved.tensors, path, metadata=foreign)
        with pytest.raises(BadInput, match="not a readable checkpoint"):
            checkpoint.load(path)
    path = checkpoint.save(tmp_path, checkpoint.Checkpoint(saved.tensors, saved.facts | {"version": 1}))
    for read in (checkpoint.load, checkpoint.read_facts):
        with pytest.raises(BadInput, match=f"has version 1, this is version {checkpoint.VERSION}. Train again"):
            read(path)


def test_a_checkpoint_that_may_not_be_read_is_not_called_missing(tmp_path, monkeypatch):
    path = checkpoint.save(tmp_path, checkpoint.Checkpoint({"a.b": torch.arange(3)}, {"step": 7}))
    monkeypatch.setattr(Path, "open", failing(DENIED))
    with pytest.raises(PermissionError):
        checkpoint.load(path)


@pytest.mark.parametrize(
    "problem",
    [
        MemoryError(),
        torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20.00 GiB."),
        RuntimeError("CUDA error of cuModuleLoadData: out of memory"),
        RuntimeError("CUDA error: CUBLAS_STATUS_ALLOC_FAILED when calling `cublasCreate(handle)`"),
        RuntimeError(
            "unable to mmap 7666892 bytes from file <checkpoint_000010.safetensors>: Cannot allocate memory (12)"
        ),
        RuntimeError("can't start new thread"),
        RuntimeError("[enforce fail at alloc_cpu.cpp:127] err == 0. DefaultCPUAllocator: can't allocate memory"),
    ],
    ids=lambda problem: str(problem)[:40],
)
def test_where_memory_runs_out_no_checkpoint_is_called_broken(tmp_path, monkeypatch, problem):
    path = checkpoint.save(tmp_path, checkpoint.Checkpoint({"a.b": torch.arange(3)}, {"step": 7}))
    monkeypatch.setattr(checkpoint, "safe_open", failing(problem))
    with pytest.raises(type(problem)) as read:
        checkpoint.load(path)
    with pytest.raises(type(problem)) as built, checkpoint.fitting(path):
        raise problem
    assert read.value is built.value is problem and as_out_of_memory(problem) is not None


def test_a_checkpoint_that_the_next_one_replaces_while_it_is_read_is_no_damage(tmp_path):
    def saved(step):
        return checkpoint.save(tmp_path, checkpoint.Checkpoint({"a.b": torch.arange(3)}, {"step": step}))

    first, read = saved(7), []

    def read_late(path):
        read.append(path.name)
        if path == first:
            saved(8)
        return checkpoint.load(path)

    path, found = checkpoint.read_newest(tmp_path, read_late)
    assert found.facts["step"] == 8 and read == [first.name, path.name]
    path.write_bytes(b"")
    with pytest.raises(BadInput, match="not a readable checkpoint"):
        checkpoint.read_newest(tmp_path, checkpoint.load)
    path.unlink()
    assert checkpoint.read_newest(tmp_path, checkpoint.load) is None
