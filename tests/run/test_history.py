"""history.csv: it is written row by row, read without what a killed program garbled, and cut back to a checkpoint."""

import csv
import errno

import pytest

from core.errors import BadInput
from core.run import history
from tests.failing import failing


def test_rows_are_on_disk_at_once_and_go_on_after_a_pause(tmp_path):
    for step in (5, 10):
        history.add_row(
            tmp_path,
            ("step", history.HELD_OUT),
            {"step": step, history.HELD_OUT: 20.5 if step == 10 else None, "messages": ()},
        )
        lines = (tmp_path / "history.csv").read_text().splitlines()
        assert lines[-1] == ("5," if step == 5 else "10,20.5")
    assert lines[0] == f"step,{history.HELD_OUT}" and len(lines) == 3


def test_checks_are_the_rows_that_measured_and_can_be_read(tmp_path):
    assert history.checks(tmp_path) == []
    (tmp_path / "history.csv").write_bytes(
        b"step,held_out_psnr,held_out_ssim\n5,,\n6,20.5,0.5\n7,x,0.5\n8,21,0.5,7\n\xff,1\n9,22,\n10,2"
    )
    assert history.checks(tmp_path) == [
        {"step": 6, "held_out_psnr": 20.5, "held_out_ssim": 0.5},
        {"step": 9, "held_out_psnr": 22},
    ]


def test_a_folder_in_place_of_the_history_is_refused(tmp_path):
    (tmp_path / "history.csv").mkdir()
    for need in (lambda: history.checks(tmp_path), lambda: history.rewind(tmp_path, 20)):
        with pytest.raises(BadInput, match="history.csv is a folder. Move it away"):
            need()


def test_a_row_that_the_disk_refuses_names_the_file(tmp_path, monkeypatch):
    monkeypatch.setattr(csv.DictWriter, "writerow", failing(OSError(errno.EIO, "Input/output error")))
    with pytest.raises(OSError) as caught:
        history.add_row(tmp_path, ("step",), {"step": 5})
    assert caught.value.filename == str(tmp_path / "history.csv")


@pytest.mark.parametrize("end", ["", "9" * 6000 + ",1\r\n", "40,1", "40,1.0\r\n50,1.2\r\n50", "abc\r\n,\r\n\0\0"])
def test_history_forgets_what_a_killed_run_will_do_again(tmp_path, end):
    kept = "step,seconds\r\n10,0.5\r\n20,0.7\r\n"
    (tmp_path / "history.csv").write_text(kept + end, newline="")
    history.rewind(tmp_path, 20)
    assert (tmp_path / "history.csv").read_bytes() == kept.encode()
    history.rewind(tmp_path / "none", 20)  # killed before its first line


def test_history_begins_anew_where_not_even_its_header_is_whole(tmp_path):
    (tmp_path / "history.csv").write_text("step,held")
    history.rewind(tmp_path, 20)
    history.add_row(tmp_path, ("step", history.HELD_OUT), {"step": 21, history.HELD_OUT: 20.5})
    assert history.checks(tmp_path) == [{"step": 21, "held_out_psnr": 20.5}]
