"""A folder held by one process at a time, also while others remove and make it again."""

import os

import pytest

from core.system import lock
from core.system.lock import taken


def test_a_folder_is_held_by_one_process_after_the_other(tmp_path):
    with taken(tmp_path) as first, taken(tmp_path) as second:
        assert (first, second) == (True, False)
    with taken(tmp_path) as again:
        assert again


@pytest.mark.parametrize("removed", ["before it is opened", "after", "after, and made again"])
def test_a_folder_that_another_removes_meanwhile_is_not_taken(tmp_path, monkeypatch, removed):
    """A lock on a folder that is gone holds nobody off."""
    folder, really_open = tmp_path / "work", os.open
    folder.mkdir()

    def open_while_another_removes(path, flags):
        if removed == "before it is opened":
            folder.rmdir()
        descriptor = really_open(path, flags)
        folder.rmdir()
        if removed == "after, and made again":
            folder.mkdir()
        return descriptor

    monkeypatch.setattr(os, "open", open_while_another_removes)
    with taken(folder) as ours:
        assert ours is False


def test_without_locks_nobody_knows_whether_a_folder_is_held(tmp_path, monkeypatch):
    monkeypatch.setattr(lock, "fcntl", None)
    with taken(tmp_path) as ours:
        assert ours is None
