"""Outputs that cannot be written are refused before the work."""

import errno
import os
import re
import sys
import tempfile
from pathlib import Path

import pytest

from core.errors import BadInput, DiskFull
from core.system.outputs import check_apart, check_file, check_folder
from tests.failing import failing


def test_where_nothing_can_be_written_is_known_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="file is not a folder"):
        check_file(tmp_path / "file" / "a.ply")
    with pytest.raises(BadInput, match=f"mkdir -p '{re.escape(str(tmp_path))}/no such'$"):
        check_file(tmp_path / "no such" / "a.ply")
    with pytest.raises(BadInput, match="names no home folder.*Type: -o ~/a.ply, with a space"):
        check_file(Path("~/a.ply"))
    check_folder(tmp_path / "none" / "none")  # can be made
    with monkeypatch.context() as without, pytest.raises(BadInput, match="X:/none is not a folder"):
        without.setattr(os.path, "lexists", lambda path: False)  # as on a drive that Windows lacks
        check_folder(Path("X:/none"))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("refusal", "error", "words"),
    [
        (errno.EACCES, BadInput, "{} may not be written in: Permission denied"),
        (errno.ENOSPC, DiskFull, "The disk is full: {}"),
    ],
)
def test_a_folder_that_the_system_refuses_to_write_in_is_known_before_the_work(
    tmp_path, monkeypatch, refusal, error, words
):
    monkeypatch.setattr(tempfile, "mkdtemp", failing(OSError(refusal, os.strerror(refusal))))
    for check, path in ((check_file, tmp_path / "a.ply"), (check_folder, tmp_path / "none" / "none")):
        with pytest.raises(error, match=words.format(tmp_path)):
            check(path)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has such a folder")
def test_not_even_root_can_write_in_proc():
    with pytest.raises(BadInput, match="/proc may not be written in"):
        check_file(Path("/proc/a.ply"))


def test_no_input_may_lie_in_a_folder_that_is_replaced(tmp_path):
    (tmp_path / "a.jpg").touch()
    check_apart(tmp_path / "fade", [tmp_path / "a.jpg"])
    check_apart(tmp_path, [tmp_path / "neutral"])  # the name of a look, as one types it there
    with pytest.raises(BadInput, match="a.jpg lies in .*, whose files are replaced"):
        check_apart(tmp_path, [tmp_path / "neutral", tmp_path / "a.jpg"])
