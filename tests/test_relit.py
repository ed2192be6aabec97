"""Looks seen by cameras other than their photos': the truth is that of the sample, and cameras beside a photo are those that see alike."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from click.testing import CliRunner

from core.config import preset
from core.pipeline import evaluate, train
from samples import relit
from samples.measurements.finished import with_split
from tests.elsewhere import DEVICE, elsewhere
from tests.small import ring_camera
from tests.test_plaza_sample import PLAZA


def test_a_photos_own_camera_is_scored_as_by_eval_and_others_beside_it(tmp_path, monkeypatch):
    header, *rows = (PLAZA / "plaza.tsv").read_text().splitlines()
    splits = [[row for row in rows if f"\t{split}\t" in row] for split in ("train", "test")]
    (tmp_path / "few.tsv").write_text("\n".join([header, *splits[0][:12], *splits[1][:2]]) + "\n")
    scene = with_split(PLAZA, tmp_path / "few.tsv", tmp_path)
    small = {"steps": 30, "max_gaussians": 6000, "sky_gaussians": 100, "encoder_side_px": 30, "resolution": 8, "held_out_checks": 0}
    train(scene, preset("quick").changed(**small), tmp_path / "run")
    scores = evaluate(tmp_path / "run", "full").to_json()["means"]["clean"]
    monkeypatch.setattr(relit, "CAMERAS", 1)
    told = CliRunner().invoke(relit.main, [str(tmp_path / "run"), "--grid", "1"], catch_exceptions=False).output.splitlines()
    own, alike, others = ([float(figure) for figure in line.split("|")[2:4]] for line in told[-3:])
    assert own == pytest.approx([scores[look]["psnr"] for look in ("zero_shot", "refined")], abs=0.3)
    assert own != alike != others and all(8 < figure < own[1] for figure in (*alike, *others))


def test_the_truth_is_where_the_run_is(monkeypatch):
    photo = SimpleNamespace(camera=ring_camera(0.0))
    view = SimpleNamespace(render=lambda look: torch.full((photo.camera.height, photo.camera.width, 3), look).to(DEVICE))
    trained = SimpleNamespace(device=DEVICE, collection=SimpleNamespace(view=lambda _: photo), camera=lambda _: photo.camera, seen_by=lambda _: view)
    monkeypatch.setattr(relit, "lit", lambda _, width, height, *__: np.zeros((height, width, 3), np.float32))
    with elsewhere():
        assert relit.scores(trained, [1.0, 0.1], "photo", {}, None, None, 1) == pytest.approx([0.0, 20.0], abs=0.2)


def test_cameras_that_see_most_alike_are_told_from_the_others():
    turned = {"world_to_camera": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]}
    ahead = {"world_to_camera": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}
    taken = {f"{name}.png": {"camera": {"centre": [float(place), 0, 0], **ahead}} for place, name in enumerate("abcdefgh")}
    taken["b.png"]["camera"] |= turned
    own, alike, others = relit.cameras_beside("a.png", taken)
    assert own == ["a.png"] and alike == ["c.png", "d.png", "e.png"] and others == ["f.png", "g.png", "b.png"]
