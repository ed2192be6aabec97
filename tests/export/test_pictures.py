"""PNG, contact sheet, video, and files and folders that appear whole or not at all."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from core.errors import BadInput, WegsError
from core.export.labelled_sheet import LABEL_PX, line_of_text
from core.export.pictures import TILE_PX, contact_sheet, to_8_bit, write_png, write_video
from core.system import lock
from core.system.atomic import check_file, check_folder, files_in, filling, replacing, write_json


def test_rendering_to_pixels_clamps_and_rounds():
    image = torch.tensor([[[-0.5, 0.0, 0.4999 / 255], [0.5001 / 255, 1.0, 7.0]]])
    assert to_8_bit(image).tolist() == [[[0, 0, 0], [1, 255, 255]]]


def test_a_png_holds_the_pixels_in_rgb(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 3)).astype(np.uint8)
    write_png(tmp_path / "a.png", pixels)
    back = cv2.cvtColor(cv2.imread(str(tmp_path / "a.png")), cv2.COLOR_BGR2RGB)
    np.testing.assert_array_equal(back, pixels)


@pytest.mark.parametrize(
    "frames, rows",
    [
        (1, [[10]]),
        (5, [[10, 20, 30, 40, 50]]),
        (6, [[10, 20, 30], [40, 50, 60]]),
        (7, [[10, 20, 30, 40], [50, 60, 70, 255]]),
        (11, [[10, 20, 30, 40], [50, 60, 70, 80], [90, 100, 110, 255]]),
    ],
)
def test_a_sheet_reads_row_by_row_in_even_rows(frames, rows):
    sheet = contact_sheet("noon to dusk", [np.full((20, 30, 3), 10 * (number + 1), np.uint8) for number in range(frames)])
    assert sheet[:LABEL_PX].any()
    sheet = sheet[LABEL_PX:]
    assert sheet[10::20, 15::30, 0].tolist() == rows
    assert sheet.shape == (20 * len(rows), 30 * len(rows[0]), 3)


def test_a_long_text_is_written_smaller_before_it_is_cut():
    def reach(text, step):
        columns = np.flatnonzero(line_of_text(step, [text]).any(axis=(0, 2)))
        return columns.max()

    text = "half: right halves, refined"
    usual = reach(text, 1000)
    assert reach("half", 200) == reach("half", 1000)
    assert usual * 0.7 <= reach(text, int(usual * 0.8)) <= usual * 0.8 - 2  # all of it, up to its margin
    assert reach(text, 60) == 59


def test_large_frames_are_shrunk_on_the_sheet():
    sheet = contact_sheet("noon to dusk", [np.full((300, 2 * TILE_PX, 3), 9, np.uint8)] * 2)
    assert sheet.shape == (LABEL_PX + 150, 2 * TILE_PX, 3)


def test_a_video_has_every_frame_even_at_an_odd_size(tmp_path):
    frames = [np.full((49, 65, 3), 25 * number, np.uint8) for number in range(10)]
    write_video(tmp_path / "a.mp4", frames)
    video = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    means = []
    while (frame := video.read())[0]:
        assert frame[1].shape == (48, 64, 3)
        means.append(float(frame[1].mean()))
    np.testing.assert_allclose(means, [25 * number for number in range(10)], atol=4)  # video is lossy


@pytest.mark.parametrize("frames, fps", [(6, 2), (90, 30), (120, 30)])
def test_a_video_lasts_three_seconds_or_as_long_as_its_frames_need(frames, fps, tmp_path):
    write_video(tmp_path / "a.mp4", [np.zeros((16, 16, 3), np.uint8)] * frames)
    assert cv2.VideoCapture(str(tmp_path / "a.mp4")).get(cv2.CAP_PROP_FPS) == pytest.approx(fps)


@pytest.mark.parametrize("lacking, codec", [((), "vp09"), (("vp09",), "mp4v")])
def test_a_video_plays_in_browsers_where_opencv_can_write_such(tmp_path, monkeypatch, lacking, codec):
    class Writer:
        """OpenCV's writer, built without some codecs."""

        def __init__(self, path, code, *rest):
            has = code not in [cv2.VideoWriter_fourcc(*name) for name in lacking]
            self.writer = made(path, code, *rest) if has else made()

        def __getattr__(self, name):
            return getattr(self.writer, name)

    made = cv2.VideoWriter
    monkeypatch.setattr(cv2, "VideoWriter", Writer)
    write_video(tmp_path / "a.mp4", [np.zeros((32, 32, 3), np.uint8)] * 3)
    assert codec.encode() in (tmp_path / "a.mp4").read_bytes()  # the name of its sample entry


def test_a_video_may_have_a_colon_in_its_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("noon:dusk").mkdir()
    write_video(Path("noon:dusk/a.mp4"), [np.zeros((8, 8, 3), np.uint8)] * 2)
    assert [path.name for path in Path("noon:dusk").iterdir()] == ["a.mp4"]


def test_a_video_that_was_cut_short_is_noticed(tmp_path, monkeypatch):
    class FullDisk:
        """OpenCV's writer where the disk is full: no error, and a file without its end."""

        def __init__(self, path, *_):
            self.path = path

        def isOpened(self):
            return True

        def write(self, frame):
            Path(self.path).write_bytes(b"\0\0\0\x1cftypisom")

        def release(self):
            pass

    monkeypatch.setattr(cv2, "VideoWriter", FullDisk)
    with pytest.raises(WegsError, match="a.mp4 could not be written whole"):
        write_video(tmp_path / "a.mp4", [np.zeros((8, 8, 3), np.uint8)])
    assert list(tmp_path.iterdir()) == []


def test_a_png_may_be_grey(tmp_path):
    pixels = np.arange(12, dtype=np.uint8).reshape(3, 4)
    write_png(tmp_path / "a.png", pixels)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED), pixels)


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

    def interrupt(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), filling(folder, ("*",), True) as work:
        (work / "0.txt").write_text("three")
        monkeypatch.setattr("core.system.atomic.os.replace", interrupt)
    assert (folder / "0.txt").read_text() == "two" and (folder / "sub").is_dir()


@pytest.mark.skipif(lock.fcntl is None, reason="this system has no flock(2)")
def test_what_a_killed_process_left_is_removed_and_what_is_at_work_is_not(tmp_path):
    def old(name):
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (1e9, 1e9))
        return tmp_path / name

    killed, other, foreign = old(".fade.wegs-1"), old(".sheet.wegs-1"), old(".fade.mine")
    (tmp_path / ".fade.wegs-2").mkdir()  # of a process that is about to hold it
    with filling(tmp_path / "fade", ("*.png",), False) as first:
        assert not killed.exists() and other.exists() and foreign.exists()
        os.utime(first, (1e9, 1e9))
        with filling(tmp_path / "fade", ("*.png",), False) as second:
            assert first != second and first.exists()
            (second / "a.png").touch()
    assert sorted(path.name for path in tmp_path.iterdir()) == [".fade.mine", ".fade.wegs-2", ".sheet.wegs-1", "fade"]


@pytest.mark.skipif(lock.fcntl is None, reason="this system has no flock(2)")
def test_half_a_file_that_a_killed_process_left_is_removed_by_the_next(tmp_path):
    program = (
        "import os, signal, sys\nfrom pathlib import Path\nfrom core.system.atomic import replacing\n"
        "with replacing(Path(sys.argv[1])) as work:\n    work.write_text('half')\n    os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", program, str(tmp_path / "look.ply")], check=False)
    (left,) = tmp_path.iterdir()
    assert files_in(tmp_path) == []  # in nobody's way
    os.utime(left, (1e9, 1e9))
    write_json(tmp_path / "other.json", {})
    assert left.exists()
    with replacing(tmp_path / "look.ply") as work:
        work.write_text("whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["look.ply", "other.json"]


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


def test_where_nothing_can_be_written_is_known_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="file is not a folder"):
        check_file(tmp_path / "file" / "a.ply")
    with pytest.raises(BadInput, match="mkdir -p .*'?no such'?"):
        check_file(tmp_path / "no such" / "a.ply")
    with pytest.raises(BadInput, match="names no home folder.*Type: -o ~/a.ply, with a space"):
        check_file(Path("~/a.ply"))
    check_folder(tmp_path / "none" / "none")  # can be made
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # who runs the tests may be root, who may write anywhere
    for check, path in ((check_file, tmp_path / "a.ply"), (check_folder, tmp_path / "none" / "none")):
        with pytest.raises(BadInput, match=f"{tmp_path} may not be written in"):
            check(path)


def test_a_temporary_file_that_cannot_be_removed_hides_no_error(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(os, "rmdir", refuse)
    with pytest.raises(BadInput, match="could not be written"), replacing(tmp_path / "a.ply"):
        raise OSError(errno.EROFS, "Read-only file system")
