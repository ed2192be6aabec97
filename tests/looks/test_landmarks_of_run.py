"""The landmarks that a run keeps: of all photos that it was trained on, and of no others."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from core.data.prepare import prepared
from core.data.sfm.landmarks import Landmarks
from core.errors import BadInput
from core.looks import refined_look
from core.looks.find_look import find_look
from core.looks.trained import TrainedRun
from core.report import Report
from tests.data.room_corner import HEIGHT, WIDTH
from tests.failing import failing
from tests.heard import Heard
from tests.looks.lit_corner import lit_corner


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> TrainedRun:
    """The room corner, barely trained; photo 0 is held out."""
    return lit_corner(tmp_path_factory.mktemp("corner"), steps=20)


def test_landmarks_are_not_kept_until_all_photos_can_be_read(trained, tmp_path):
    """What is found while a disk is half copied would else lose photos for good."""
    shutil.copytree(trained.collection.photos[0].path.parent, tmp_path / "scene")
    (tmp_path / "run").mkdir()
    run = replace(
        trained, folder=tmp_path / "run", collection=prepared(tmp_path / "scene", tmp_path / "points", Report())
    )
    lost, damaged = (run.collection.photo(name).path for name in ("3.png", "4.png"))
    whole = [path.read_bytes() for path in (lost, damaged)]
    heard = Heard()
    lost.unlink()
    assert len(refined_look.landmarks_of_run(run, heard).counts) == 4 and not list(run.folder.iterdir())
    assert any("1 training photo of 5 cannot be read now" in line for line in heard.lines)
    lost.write_bytes(whole[0])
    damaged.write_bytes(whole[1][:200])
    assert len(refined_look.landmarks_of_run(run, Report()).counts) == 4 and not list(run.folder.iterdir())
    damaged.write_bytes(whole[1])
    assert len(refined_look.landmarks_of_run(run, Report()).counts) == 5 and list(run.folder.iterdir())


def test_landmarks_do_not_wait_for_photos_that_training_left_out(trained, tmp_path, monkeypatch):
    monkeypatch.setattr(trained.model, "photo_names", [name for name in trained.model.photo_names if name != "4.png"])
    run = replace(trained, folder=tmp_path)
    assert len(refined_look.landmarks_of_run(run, Report()).counts) == 4 and list(tmp_path.iterdir())


def test_a_scene_that_does_not_say_which_photo_sees_which_point_is_reported(trained, tmp_path, monkeypatch):
    monkeypatch.setattr(refined_look, "known_photos", lambda collection: [])
    wall = tmp_path / "wall.png"
    cv2.imwrite(str(wall), np.full((HEIGHT, WIDTH, 3), 120, np.uint8))
    heard = Heard()
    find_look(replace(trained, folder=tmp_path), str(wall), report=heard)
    assert any("does not tell which photo shows which point; so wall.png" in line for line in heard.lines)


def test_landmarks_can_be_used_in_a_run_that_may_not_be_written_in(trained, tmp_path, monkeypatch):
    monkeypatch.setattr(Landmarks, "save", failing(BadInput("The folder may not be written in.", "Use another.")))
    heard = Heard()
    known = refined_look.landmarks_of_run(replace(trained, folder=tmp_path), heard)
    assert len(known.counts) == 5 and not list(tmp_path.iterdir())
    said = "! The folder may not be written in. The next new photo has the features extracted again."
    assert said in heard.lines  # there is no other folder to use


def test_landmarks_are_not_kept_in_a_run_that_was_replaced_meanwhile(trained, tmp_path):
    (tmp_path / "config.json").write_text('{"run": "another"}')
    heard = Heard()
    refined_look.landmarks_of_run(replace(trained, folder=tmp_path), heard)
    assert any(line.startswith(f"! {tmp_path} holds another run than before.") for line in heard.lines)
    assert [path.name for path in tmp_path.iterdir()] == ["config.json"]
