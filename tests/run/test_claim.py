"""Only one training uses a run folder: a second one takes another folder, or is refused."""

import os
import time
from pathlib import Path

import pytest

from core.errors import BadInput
from core.run import claim
from core.run.claim import held, new_run
from core.system import lock
from tests.failing import failing

pytestmark = pytest.mark.usefixtures("here")
locks = pytest.mark.skipif(lock.fcntl is None, reason="this system has no flock(2)")


def test_trainings_begun_together_get_folders_of_their_own(monkeypatch):
    with new_run(None, "plaza") as first, new_run(None, "plaza") as second:
        assert (first, second) == (Path("runs/plaza"), Path("runs/plaza-2"))
        (second / "config.json").write_text("{}")
        # Both saw that a name is free, and one was faster.
        names = iter([first, Path("runs/plaza-3")])
        monkeypatch.setattr(claim.run_folders, "choose_folder", lambda *_: next(names))
        with new_run(None, "plaza") as third:
            assert third == Path("runs/plaza-3")
    assert [path.name for path in Path("runs").iterdir()] == ["plaza-2"]


def test_a_name_that_a_broken_link_has_is_not_free():
    Path("runs").mkdir()
    Path("runs/plaza").symlink_to("nowhere")
    with new_run(None, "plaza") as folder:
        assert folder == Path("runs/plaza-2")
    with (
        pytest.raises(BadInput, match="runs/plaza is not a folder. Write to another folder"),
        new_run(Path("runs/plaza"), "plaza"),
    ):
        pass


@locks
def test_a_folder_that_a_killed_training_left_empty_is_used_again():
    (Path("runs/plaza")).mkdir(parents=True)
    with new_run(None, "plaza") as folder:  # so young, it may be one that another training is about to hold
        assert folder == Path("runs/plaza-2")
    long_ago = time.time() - 60
    os.utime("runs/plaza", (long_ago, long_ago))
    with held(Path("runs/plaza")), new_run(None, "plaza") as folder:
        assert folder == Path("runs/plaza-2")
    with new_run(None, "plaza") as folder:
        assert folder == Path("runs/plaza")


def test_a_broken_link_in_place_of_runs_is_refused():
    Path("runs").symlink_to("nowhere")
    with pytest.raises(BadInput, match="runs is not a folder. Write to another folder"), new_run(None, "plaza"):
        pass


@locks
def test_a_folder_that_is_trained_in_is_left_alone():
    with new_run(Path("a/b"), "plaza") as folder:
        (folder / "config.json").write_text('{"wegs": "0.1.0"}')
        for second in (held(folder), new_run(folder, "plaza", force=True)):
            with pytest.raises(BadInput, match="Another `wegs train` is at work in a/b"), second:
                pass
    with held(folder):  # let go at the end
        assert [path.name for path in folder.iterdir()] == ["config.json"]


def test_a_disk_without_locks_is_used_all_the_same(monkeypatch):
    if lock.fcntl is not None:
        monkeypatch.setattr(lock.fcntl, "flock", failing(OSError("No locks available")))
    with new_run(Path("run"), "plaza") as folder:
        assert folder.is_dir()


def test_a_training_that_does_not_begin_leaves_no_folder(here):
    with pytest.raises(KeyboardInterrupt), new_run(Path("deep/er/run"), "plaza"):
        raise KeyboardInterrupt
    assert list(here.iterdir()) == []
