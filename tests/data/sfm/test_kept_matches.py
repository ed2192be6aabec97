"""Structure from motion that was stopped can go on, with the same result."""

import errno
import os
import shutil
import signal
import sqlite3
from contextlib import closing
from types import SimpleNamespace

import cv2
import pytest

from core.data.sfm import features, reconstruct
from core.data.sfm.features import DATABASE
from core.data.sfm.kept_matches import keep_if_of, work_kept_if_stopped
from core.errors import BadInput, WegsError, disk_full
from core.report import QUIET
from core.system import lock
from core.system.atomic import replacing_folder, temporary_folder
from tests.data.room_corner import save_corner
from tests.failing import opencv_error
from tests.heard import Heard
from tests.programs import run_python

pytestmark = pytest.mark.skipif(lock.fcntl is None, reason="this system has no flock(2)")
AGAIN = "Going on with the features and matches that were found before it was stopped."


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    return save_corner(tmp_path_factory.mktemp("photos"), [f"{number}.jpg" for number in range(6)])


@pytest.fixture(scope="module")
def whole(photos, tmp_path_factory):
    """The scene of a search that was not stopped."""
    return reconstruct.reconstruct(photos, tmp_path_factory.mktemp("whole") / "scene", QUIET)


class StopsAt(Heard):
    def __init__(self, stage: str):
        super().__init__()
        self.stage = stage

    def progress(self, what, done, total, note="", share=None):
        if what == self.stage:
            raise KeyboardInterrupt


def counts(database) -> tuple[int, int]:
    with closing(sqlite3.connect(database)) as connection:
        return tuple(
            connection.execute(f"SELECT COUNT(*) FROM {table}").fetchone()[0]
            for table in ("keypoints", "two_view_geometries")
        )


def a_table(work) -> None:
    """Makes a database that is sound."""
    with closing(sqlite3.connect(work / DATABASE)) as connection:
        connection.execute("CREATE TABLE t (x)")


def is_same(scene, other) -> bool:
    return all(
        (scene / "sparse/0" / name).read_bytes() == (other / "sparse/0" / name).read_bytes()
        for name in ("cameras.bin", "images.bin", "points3D.bin")
    )


@pytest.mark.parametrize(("stage", "found"), [("Features", (2, 0)), ("Matches", (6, 8)), ("Cameras", (6, 15))])
def test_what_was_found_before_ctrl_c_is_used_again(photos, whole, tmp_path, monkeypatch, stage, found):
    monkeypatch.setattr(features, "PART_S", 0.0)  # the smallest parts
    stopped = StopsAt(stage)
    with pytest.raises(KeyboardInterrupt):
        reconstruct.reconstruct(photos, tmp_path / "scene", stopped)
    (kept,) = tmp_path.iterdir()
    assert (
        stopped.lines[-1]
        == f"The features and matches found so far are kept in {kept}: the same command goes on from there."
    )
    assert {path.name.partition("-")[0] for path in kept.iterdir()} <= {DATABASE, "matches"} and counts(
        kept / DATABASE
    ) == found
    heard = Heard()
    scene = reconstruct.reconstruct(photos, tmp_path / "scene", heard)
    assert heard.lines.count(AGAIN) == 1 and is_same(scene, whole)
    assert list(tmp_path.iterdir()) == [scene]


def test_what_was_found_before_a_kill_is_used_again(photos, whole, tmp_path):
    program = (
        "import os, signal, sys\nfrom pathlib import Path\nfrom core.data.sfm import features, reconstruct\nfrom core.report import Report\n"
        "features.PART_S = 0.0\n"
        "class Killed(Report):\n"
        "    def progress(self, what, done, total, note='', share=None):\n"
        "        if what == 'Matches': os.kill(os.getpid(), signal.SIGKILL)\n"
        "reconstruct.reconstruct(Path(sys.argv[1]), Path(sys.argv[2]), Killed())"
    )
    assert run_python(program, photos, tmp_path / "scene", check=False).returncode == -signal.SIGKILL
    heard = Heard()
    assert is_same(reconstruct.reconstruct(photos, tmp_path / "scene", heard), whole) and AGAIN in heard.lines


def test_features_of_other_photos_are_not_reused(photos, tmp_path):
    fewer = tmp_path / "photos"
    shutil.copytree(photos, fewer)
    with pytest.raises(KeyboardInterrupt):
        reconstruct.reconstruct(fewer, tmp_path / "scene", StopsAt("Matches"))
    (fewer / "5.jpg").unlink()
    heard = Heard()
    reconstruct.reconstruct(fewer, tmp_path / "scene", heard)
    assert AGAIN not in heard.lines


def stopped_at(output, problem, begin):
    with pytest.raises(type(problem)), work_kept_if_stopped(output, QUIET) as work:
        begin(work)
        raise problem


@pytest.mark.parametrize(
    "problem", [BadInput("no"), WegsError("no"), RuntimeError("a defect, which may lie in the database")]
)
def test_mistakes_and_defects_leave_nothing(tmp_path, problem):
    stopped_at(tmp_path / "scene", problem, lambda work: (work / DATABASE).touch())
    assert list(tmp_path.iterdir()) == []


def test_an_early_stop_leaves_nothing(tmp_path):
    stopped_at(tmp_path / "scene", KeyboardInterrupt(), lambda work: (work / "photos").mkdir())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "problem",
    [
        KeyboardInterrupt(),
        MemoryError(),
        opencv_error(cv2.Error.StsNoMem),
        OSError(errno.ENOSPC, "full"),
        disk_full("matches-of.json"),
    ],
)
@pytest.mark.parametrize(
    "name", ["sfm", "a b", "ö" * 125, "😀" * 60], ids=["short", "space", "long", "longest letters"]
)
def test_the_database_outlives_a_stop_whatever_the_scene_is_called(tmp_path, problem, name):
    def begin(work):
        keep_if_of({"a": 1}, work, QUIET)
        a_table(work)

    for output in (tmp_path / name, tmp_path / "there" / "sfm"):
        output.parent.mkdir(exist_ok=True)
        if output.parent != tmp_path:
            output.mkdir()
        stopped_at(output, problem, begin)
        with temporary_folder(output):  # which sweeps what killed programs left
            pass
        heard = Heard()
        with work_kept_if_stopped(output, QUIET) as work:
            keep_if_of({"a": 1}, work, heard)
            assert heard.lines == [AGAIN] and (work / DATABASE).exists()
            keep_if_of({"a": 2}, work, heard)
            assert heard.lines == [AGAIN] and not (work / DATABASE).exists()


def test_on_a_full_disk_that_pycolmap_calls_otherwise_the_database_is_kept_as_well(tmp_path, monkeypatch):
    output, copy = tmp_path / "scene", "000001.jpg"

    def room(_):
        return SimpleNamespace(free=0 if list(tmp_path.rglob(copy)) else 1 << 30)  # again once the copies are gone

    monkeypatch.setattr(shutil, "disk_usage", room)
    with (
        pytest.raises(WegsError, match="The disk is full: .*scene was not written"),
        replacing_folder(output),
        work_kept_if_stopped(output, QUIET) as work,
    ):
        keep_if_of({}, work, QUIET)
        a_table(work)
        (work / copy).touch()
        raise RuntimeError("No registered database factory succeeded.")
    assert [path.name for path in work.iterdir() if path.name == DATABASE or path.name == copy] == [DATABASE]


@pytest.mark.parametrize("content", [b"", b"garbage" * 999, "half"])
def test_a_damaged_database_is_not_used(tmp_path, content):
    keep_if_of({}, tmp_path, QUIET)
    a_table(tmp_path)
    with closing(sqlite3.connect(tmp_path / DATABASE)) as connection, connection:
        connection.executemany("INSERT INTO t VALUES (?)", [("x" * 500,)] * 100)
    whole = (tmp_path / DATABASE).read_bytes()
    (tmp_path / DATABASE).write_bytes(whole[: len(whole) // 2] if content == "half" else content)
    heard = Heard()
    keep_if_of({}, tmp_path, heard)
    assert heard.lines == ([AGAIN] if content == b"" else []) and (tmp_path / DATABASE).exists() == (
        content == b""
    )  # empty: of a stop before the first table


def test_two_at_once_do_not_share(tmp_path, monkeypatch):
    with (
        work_kept_if_stopped(tmp_path / "scene", QUIET) as first,
        work_kept_if_stopped(tmp_path / "scene", QUIET) as second,
    ):
        assert first != second
    monkeypatch.setattr(lock, "fcntl", None)
    with work_kept_if_stopped(tmp_path / "scene", QUIET):
        pass
    assert os.listdir(tmp_path) == []
