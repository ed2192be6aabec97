"""What the doctor does not examine is refused in one line, which says what to give it; cameras farther up are ignored."""

import os
from pathlib import Path

import numpy as np
import pytest

from core.doctor import examine
from core.errors import BadInput
from tests.doctor.examined import examined
from tests.doctor.plies import cameras_json, sound_rows, write
from tests.heard import Heard


def test_points_and_other_files_are_refused_in_one_line(tmp_path):
    points = np.zeros(3, dtype=[(name, "<f4") for name in "xyz"])
    with pytest.raises(BadInput, match="lacks the column f_dc_0. It is not a 3DGS .ply"):
        examine(write(tmp_path / "points.ply", points), Heard())
    os.mkfifo(tmp_path / "pipe")
    for path, words in (
        (tmp_path / "nowhere", f"There is no file or folder {tmp_path}/nowhere."),
        (tmp_path / "pipe", f"{tmp_path}/pipe is neither a file nor a folder."),
        (Path("/dev/null"), "/dev/null is neither a file nor a folder."),
    ):
        with pytest.raises(BadInput, match=f"^{words} Give a .ply, a run, a scene"):
            examine(path, Heard())


@pytest.mark.parametrize("name", ["a.sog", "a.SPZ", "a.splat", "a.ksplat"])
def test_gaussians_in_other_formats_are_to_be_converted(tmp_path, name):
    (tmp_path / name).write_bytes(b"PK")
    with pytest.raises(BadInput, match=f"{name} is no .ply. Convert it to one"):
        examine(tmp_path / name, Heard())


def test_given_a_folder_of_plys_or_runs_the_doctor_asks_for_one_of_them(tmp_path):
    asked = "holds no photos and no COLMAP model.* For what is in it, give the path, such as {}.$"
    write(tmp_path / "splat.ply", sound_rows())
    with pytest.raises(BadInput, match=asked.format(tmp_path / "splat.ply")):
        examine(tmp_path, Heard())
    run = tmp_path / "runs" / "plaza"
    run.mkdir(parents=True)
    (run / "config.json").write_text('{"wegs": "0.1.0"}')
    with pytest.raises(BadInput, match=asked.format(run)):
        examine(run.parent, Heard())


def test_given_a_photo_the_doctor_asks_for_its_folder(tmp_path):
    (tmp_path / "a.JPG").write_bytes(b"\xff\xd8")
    with pytest.raises(BadInput, match=f"a.JPG is a file, not a folder. Give the folder it is in: {tmp_path}$"):
        examine(tmp_path / "a.JPG", Heard())


def test_cameras_two_folders_above_a_file_are_not_taken_for_its_own(tmp_path):
    (tmp_path / "cameras.json").write_text(cameras_json((0.0, 0.0, -4.0)))
    (tmp_path / "exports" / "dusk").mkdir(parents=True)
    assert "never seen" not in examined(write(tmp_path / "exports" / "dusk" / "a.ply", sound_rows()))[0]
