"""PNG, contact sheet and video."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from core.errors import WegsError
from core.export.labelled_sheet import LABEL_PX, line_of_text
from core.export.pictures import TILE_PX, KeptPictures, contact_sheet, to_8_bit, write_png, write_video


def test_rendering_to_pixels_clamps_and_rounds():
    image = torch.tensor([[[-0.5, 0.0, 0.4999 / 255], [0.5001 / 255, 1.0, 7.0]]])
    assert to_8_bit(image).tolist() == [[[0, 0, 0], [1, 255, 255]]]


@pytest.mark.parametrize("channels", [(), (3,)], ids=["grey", "RGB"])
def test_a_png_holds_the_pixels(tmp_path, channels):
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, *channels)).astype(np.uint8)
    write_png(tmp_path / "a.png", pixels)
    back = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(back[..., ::-1] if channels else back, pixels)


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
    sheet = contact_sheet(
        "noon to dusk", [np.full((20, 30, 3), 10 * (number + 1), np.uint8) for number in range(frames)]
    )
    assert sheet[:LABEL_PX].any()
    sheet = sheet[LABEL_PX:]
    assert sheet[10::20, 15::30, 0].tolist() == rows
    assert sheet.shape == (20 * len(rows), 30 * len(rows[0]), 3)


def test_a_long_text_is_written_smaller_and_then_without_its_middle():
    def reach(text, step):
        columns = np.flatnonzero(line_of_text(step, [text]).any(axis=(0, 2)))
        return columns.max()

    text = "half: right halves, refined"
    usual = reach(text, 1000)
    assert reach("half", 200) == reach("half", 1000)
    assert usual * 0.7 <= reach(text, int(usual * 0.8)) <= usual * 0.8 - 2  # all of it, up to its margin
    assert 40 <= reach(text, 60) <= 58  # its beginning and its end


def test_a_photo_with_the_longest_name_keeps_its_figures():
    def line(figures):
        return line_of_text(600, [f"{'x' * 251}.jpg  {figures} dB"])

    assert not np.array_equal(line(19.50), line(12.50))


def test_a_line_break_in_a_file_name_is_written_as_its_code():
    assert np.array_equal(line_of_text(200, ["lat\nin.jpg"]), line_of_text(200, ["lat\\nin.jpg"]))


def test_bytes_of_a_file_name_that_are_no_letters_are_drawn_as_question_marks():
    assert np.array_equal(line_of_text(200, ["lat\udce9n.jpg"]), line_of_text(200, ["lat?n.jpg"]))


def test_no_film_is_written_into_a_folder_whose_name_is_not_in_utf_8(tmp_path):
    folder = tmp_path / "fad\udce9"
    folder.mkdir()
    with pytest.raises(WegsError, match="is not in UTF-8. Use the frames"):
        write_video(folder / "video.mp4", [np.zeros((20, 30, 3), np.uint8)])
    assert not list(folder.iterdir())


def test_large_frames_are_shrunk_on_the_sheet():
    sheet = contact_sheet("noon to dusk", [np.full((300, 2 * TILE_PX, 3), 9, np.uint8)] * 2)
    assert sheet.shape == (LABEL_PX + 150, 2 * TILE_PX, 3)


def test_a_video_has_every_frame_in_its_colours_even_at_an_odd_size(tmp_path):
    colours = [25 * number * np.array([1.0, 0.6, 0.2]) for number in range(10)]
    frames = [np.full((49, 65, 3), colour.round(), np.uint8) for colour in colours]
    write_video(tmp_path / "a.mp4", frames)
    video = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    means = []
    while (frame := video.read())[0]:
        assert frame[1].shape == (48, 64, 3)
        means.append(frame[1].mean(axis=(0, 1))[::-1])  # as RGB
    np.testing.assert_allclose(means, colours, atol=8)  # video is lossy


@pytest.mark.parametrize("frames, fps", [(6, 2), (90, 30), (120, 30)])
def test_a_video_lasts_three_seconds_or_as_long_as_its_frames_need(frames, fps, tmp_path):
    write_video(tmp_path / "a.mp4", [np.zeros((16, 16, 3), np.uint8)] * frames)
    assert cv2.VideoCapture(str(tmp_path / "a.mp4")).get(cv2.CAP_PROP_FPS) == pytest.approx(fps)


@pytest.mark.parametrize("lacking, codec", [((), "vp09"), (("vp09",), "mp4v")])
def test_a_video_plays_in_browsers_where_opencv_can_write_such(tmp_path, monkeypatch, lacking, codec):
    class Writer:
        """OpenCV's writer, built without some codecs."""

        fourcc = cv2.VideoWriter.fourcc

        def __init__(self, path, code, *rest):
            has = code not in [self.fourcc(*name) for name in lacking]
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

        fourcc = cv2.VideoWriter.fourcc

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


def test_kept_pictures_are_those_that_were_written_also_on_a_sheet_and_in_a_video(tmp_path):
    pictures = list(np.random.default_rng(0).integers(0, 256, (3, 32, 2 * TILE_PX, 3), np.uint8))
    paths = [tmp_path / f"{number}\udce9.png" for number in range(3)]
    for path, pixels in zip(paths, pictures, strict=True):
        write_png(path, pixels)
    kept = KeptPictures(paths)
    np.testing.assert_array_equal(list(kept), pictures)
    np.testing.assert_array_equal(contact_sheet("noon to dusk", kept), contact_sheet("noon to dusk", pictures))
    for name, frames in (("kept.mp4", kept), ("held.mp4", pictures)):
        write_video(tmp_path / name, frames)
    assert (tmp_path / "kept.mp4").read_bytes() == (tmp_path / "held.mp4").read_bytes()
