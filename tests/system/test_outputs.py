"""Outputs that cannot be written are refused before the work."""

import os
from pathlib import Path

import pytest

from core.errors import BadInput
from core.system.outputs import check_file, check_folder


def test_where_nothing_can_be_written_is_known_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="file is not a folder"):
        check_file(tmp_path / "file" / "a.ply")
    with pytest.raises(BadInput, match="mkdir -p .*'?no such'?"):
        check_file(tmp_path / "no such" / "a.ply")
    with pytest.raises(BadInput, match="names no home folder.*Type: -o ~/a.ply, with a space"):
        check_file(Path("~/a.ply"))
    check_folder(tmp_path / "none" / "none")  # can be made
    with monkeypatch.context() as without, pytest.raises(BadInput, match="X:/none is not a folder"):
        without.setattr(os.path, "lexists", lambda path: False)  # as on a drive that Windows lacks
        check_folder(Path("X:/none"))
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # who runs the tests may be root, who may write anywhere
    for check, path in ((check_file, tmp_path / "a.ply"), (check_folder, tmp_path / "none" / "none")):
        with pytest.raises(BadInput, match=f"{tmp_path} may not be written in"):
            check(path)
