"""Files and folders that appear whole or not at all."""

import errno
import os
import time
from pathlib import Path

import pytest

from core.errors import BadInput, DiskFull, WegsError, disk_full
from core.system import atomic, lock
from core.system.atomic import filling, replacing, write_json
from core.system.outputs import files_in
from tests.failing import DENIED, failing
from tests.programs import run_python


def stay_fresh(folder: Path) -> None:
    """As if it had just been made, however slow the machine."""
    os.utime(folder, (time.time() + 3600,) * 2)


def test_a_file_keeps_its_old_content_when_writing_fails(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"old": True})
    before = path.read_bytes()
    with pytest.raises(TypeError):
        write_json(path, {"new": object()})
    with pytest.raises(KeyboardInterrupt), replacing(path) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    "number, kind, words",
    [
        (errno.ENOSPC, WegsError, "disk is full"),
        (errno.EACCES, BadInput, "could not be written"),
        (errno.EFBIG, BadInput, "could not be written"),  # more than 4 GB on FAT, or `ulimit -f`
        (errno.ENOENT, BadInput, "could not be written"),  # the folder was removed meanwhile
        (errno.EIO, OSError, "refused"),
    ],
)
def test_what_the_system_refuses_is_named(tmp_path, number, kind, words):
    with pytest.raises(kind, match=words), replacing(tmp_path / "a.ply"):
        raise OSError(number, "refused")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("write", [replacing, atomic.replacing_folder, lambda path: filling(path, ("*",), False)])
def test_a_file_that_cannot_be_read_meanwhile_is_not_taken_for_the_output(tmp_path, write):
    missing = tmp_path / "photos" / "a.jpg"
    with pytest.raises(FileNotFoundError) as raised, write(tmp_path / "out"):
        missing.read_bytes()
    assert raised.value.filename == str(missing) and list(tmp_path.iterdir()) == []
    with pytest.raises(BadInput, match="out could not be written"), write(tmp_path / "out") as work:
        (work / "missing" / "a.png").write_bytes(b"")


def test_a_copy_that_the_system_refuses_is_of_the_output(tmp_path):
    """Its error names the source first."""
    with (
        pytest.raises(BadInput, match="out could not be written: File too large"),
        atomic.replacing_folder(tmp_path / "out") as work,
    ):
        raise OSError(errno.EFBIG, "File too large", "photo.jpg", None, str(work / "copy.jpg"))


@pytest.mark.parametrize("name", ["a.json", "scene/a.json"])
def test_a_full_disk_names_the_output_and_no_temporary_folder(tmp_path, name):
    with (
        pytest.raises(DiskFull, match=f"The disk is full: {tmp_path / 'out'} was not written"),
        atomic.replacing_folder(tmp_path / "out") as work,
    ):
        raise disk_full(work / name)
    elsewhere = DiskFull("The disk is full: temporary files could not be written in /tmp.", "Set TMPDIR.")
    with pytest.raises(DiskFull, match="Set TMPDIR"), atomic.replacing_folder(tmp_path / "out"):
        raise elsewhere


def test_files_are_added_together_or_not_at_all(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).write_text("old")
    with pytest.raises(KeyboardInterrupt), atomic.adding(tmp_path) as work:
        (work / "a").write_text("half")
        raise KeyboardInterrupt
    assert [path.read_text() for path in sorted(tmp_path.iterdir())] == ["old", "old"]
    with atomic.adding(tmp_path) as work:
        (work / "a").write_text("new")
    assert [path.read_text() for path in sorted(tmp_path.iterdir())] == ["new", "old"]


def test_a_name_may_be_as_long_as_the_disk_allows(tmp_path):
    path = tmp_path / ("ö" * 125 + ".json")
    write_json(path, {})
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_is_filled_whole_or_not_at_all(tmp_path):
    folder = tmp_path / "fade"
    with pytest.raises(KeyboardInterrupt), filling(folder, ("*.png",), False) as work:
        (work / "a.png").write_text("half")
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []
    with filling(folder, ("*.png",), False) as work:
        (work / "a.png").write_text("one")
        (work / "b.png").write_text("one")
    with pytest.raises(BadInput, match="--force"), filling(folder, ("*.png",), False):
        pass
    with filling(folder, ("*.png",), True) as work:
        assert work.parent == folder  # which may be a disk of its own
        (work / "a.png").write_text("two")
    assert [path.name for path in folder.iterdir()] == ["a.png"] and (folder / "a.png").read_text() == "two"
    assert list(tmp_path.iterdir()) == [folder]


def test_a_folder_is_never_left_empty_while_it_is_filled_anew(tmp_path, monkeypatch):
    folder = tmp_path / "pictures"
    for text in ("one", "two"):
        with filling(folder, ("*",), True) as work:
            (work / "0.txt").write_text(text)
            (work / "sub").mkdir()
            (work / "sub" / text).touch()
    assert (folder / "0.txt").read_text() == "two" and [path.name for path in (folder / "sub").iterdir()] == ["two"]
    with pytest.raises(KeyboardInterrupt), filling(folder, ("*",), True) as work:
        (work / "0.txt").write_text("three")
        monkeypatch.setattr("core.system.atomic.os.replace", failing(KeyboardInterrupt))
    assert (folder / "0.txt").read_text() == "two" and (folder / "sub").is_dir()


@pytest.mark.skipif(lock.fcntl is None, reason="this system has no flock(2)")
def test_an_old_file_that_may_not_be_removed_is_an_error_of_the_folder(tmp_path, monkeypatch):
    (tmp_path / "old.png").write_bytes(b"old")
    monkeypatch.setattr(atomic, "remove", failing(DENIED))
    with pytest.raises(BadInput, match=f"{tmp_path} could not be written"), filling(tmp_path, ("*.png",), True) as work:
        (work / "new.png").write_bytes(b"new")


def test_what_a_killed_process_left_is_removed_and_what_is_at_work_is_not(tmp_path):
    def old(name):
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (1e9, 1e9))
        return tmp_path / name

    killed, other, foreign = old(".fade.wegs-1"), old(".sheet.wegs-1"), old(".fade.mine")
    (tmp_path / ".fade.wegs-2").mkdir()  # of a process that is about to hold it
    stay_fresh(tmp_path / ".fade.wegs-2")
    with (
        pytest.raises(BadInput, match="fade exists and is not empty. Add --force"),
        filling(tmp_path / "fade", ("*.png",), False) as first,
    ):
        (first / "a.png").write_text("late")
        assert not killed.exists() and other.exists() and foreign.exists()
        os.utime(first, (1e9, 1e9))
        with filling(tmp_path / "fade", ("*.png",), False) as second:
            assert first != second and first.exists()
            (second / "a.png").write_text("early")
    assert (tmp_path / "fade" / "a.png").read_text() == "early"
    assert sorted(path.name for path in tmp_path.iterdir()) == [".fade.mine", ".fade.wegs-2", ".sheet.wegs-1", "fade"]


@pytest.mark.skipif(lock.fcntl is None, reason="this system has no flock(2)")
def test_half_a_file_that_a_killed_process_left_is_removed_by_the_next(tmp_path):
    program = (
        "import os, signal, sys\nfrom pathlib import Path\nfrom core.system.atomic import replacing\n"
        "with replacing(Path(sys.argv[1])) as work:\n    work.write_text('half')\n    os.kill(os.getpid(), signal.SIGKILL)"
    )
    run_python(program, tmp_path / "look.ply", check=False)
    (left,) = tmp_path.iterdir()
    assert files_in(tmp_path) == []  # in nobody's way
    os.utime(left, (1e9, 1e9))
    write_json(tmp_path / "other.json", {})
    assert left.exists()
    with replacing(tmp_path / "look.ply") as work:
        work.write_text("whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["look.ply", "other.json"]


@pytest.mark.skipif(lock.fcntl is None, reason="this system has no flock(2)")
def test_what_a_kill_left_just_before_is_removed_at_the_end(tmp_path):
    killed = tmp_path / ".a.json.wegs-1"
    killed.mkdir()
    stay_fresh(killed)
    with replacing(tmp_path / "a.json") as work:
        assert killed.exists()
        os.utime(killed, (1e9, 1e9))  # old enough by now
        work.write_text("whole")
    assert list(tmp_path.iterdir()) == [tmp_path / "a.json"]


def test_a_folder_of_many_files_is_listed_once_for_each_that_is_written(tmp_path, monkeypatch):
    listed, listdir = [], os.listdir
    monkeypatch.setattr(atomic.os, "listdir", lambda folder: listed.append(folder) or listdir(folder))
    write_json(tmp_path / "a.json", {})
    assert listed.count(tmp_path) == 1


def test_a_missing_temporary_folder_is_reported(monkeypatch):
    monkeypatch.setattr(
        atomic.tempfile, "gettempdir", failing(FileNotFoundError(2, "No usable temporary directory found"))
    )
    with (
        pytest.raises(
            WegsError, match="no folder for temporary files that can be written in. Free some space, or set TMPDIR"
        ),
        atomic.scratch("a"),
    ):
        pass


def test_temporary_files_without_room_say_where_others_may_be(tmp_path, monkeypatch):
    monkeypatch.setattr(atomic.tempfile, "gettempdir", lambda: str(tmp_path))
    with (
        pytest.raises(WegsError, match=f"could not be written in {tmp_path}. Free some space, or set TMPDIR"),
        atomic.scratch("a") as work,
    ):
        raise OSError(errno.ENOSPC, "full", str(work / "a"))
    with pytest.raises(OSError), atomic.scratch("a"):  # of a log
        raise OSError(errno.ENOSPC, "full")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_was_made_for_nothing_vanishes(tmp_path):
    with pytest.raises(KeyboardInterrupt), filling(tmp_path / "run" / "pictures" / "half", ("*.png",), True):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_other_files_is_never_touched(tmp_path):
    thesis = tmp_path / "thesis.txt"
    thesis.write_text("years")
    with pytest.raises(BadInput, match="thesis.txt"), filling(tmp_path, ("*.png",), True):
        pass
    with pytest.raises(BadInput, match="not a folder"), filling(thesis, ("*.png",), True):
        pass
    assert list(tmp_path.iterdir()) == [thesis]


def test_the_folder_one_is_in_can_be_filled(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with filling(Path("."), ("*.png",), False) as work:
        (work / "a.png").write_text("one")
    assert list(tmp_path.iterdir()) == [tmp_path / "a.png"]


def test_an_error_names_the_folder_and_not_where_it_is_being_filled(tmp_path):
    fade = filling(tmp_path / "fade", ("*.png",), False)
    with pytest.raises(WegsError, match="fade/a.png") as caught, fade as work, replacing(work / "a.png"):
        raise OSError(errno.ENOSPC, "full")
    assert work.name not in str(caught.value)


def test_a_temporary_file_that_cannot_be_removed_hides_no_error(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "rmdir", failing(OSError(errno.EROFS, "Read-only file system")))
    with pytest.raises(BadInput, match="could not be written"), replacing(tmp_path / "a.ply"):
        raise OSError(errno.EROFS, "Read-only file system")
