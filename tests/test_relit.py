"""Looks seen by other cameras than their photos':
they are compared with the sample's truth, first from the cameras with the most similar views."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from click.testing import CliRunner

from core.data.load import load_collection
from core.pipeline import evaluate, train
from core.presets import preset
from samples import relit
from samples.measurements.finished import with_split
from samples.plaza_maker.model import to_model
from samples.relit import standpoint
from tests.elsewhere import DEVICE, elsewhere
from tests.paths import PLAZA
from tests.small import ring_camera


def half_as_large(*of_relit) -> relit.Standpoint:
    """With a truth of half the width and height, which takes a quarter of the time."""
    place = standpoint(*of_relit)
    view = place.view
    return replace(
        place, view=replace(view, focal_px=view.focal_px / 2, width=view.width // 2, height=view.height // 2)
    )


def test_a_photos_own_camera_is_scored_as_by_eval_and_others_beside_it(tmp_path, monkeypatch):
    header, *rows = (PLAZA / "plaza.tsv").read_text().splitlines()
    splits = [[row for row in rows if f"\t{split}\t" in row] for split in ("train", "test")]
    (tmp_path / "few.tsv").write_text("\n".join([header, *splits[0][:12], *splits[1][:2]]) + "\n")
    scene = with_split(PLAZA, tmp_path / "few.tsv", tmp_path)
    small = {
        "steps": 30,
        "max_gaussians": 6000,
        "sky_gaussians": 100,
        "encoder_side_px": 30,
        "resolution": 8,
        "held_out_checks": 0,
    }
    train(scene, preset("quick").changed(**small), tmp_path / "run")
    monkeypatch.setattr("core.appearance.refinement.STEPS", 12)
    monkeypatch.setattr("core.appearance.refinement.LATER_STEPS", 4)
    scores = evaluate(tmp_path / "run", "full").to_json()["means"]["clean"]
    monkeypatch.setattr(relit, "standpoint", half_as_large)
    monkeypatch.setattr(relit, "CAMERAS", 1)
    monkeypatch.setattr(relit, "STEPS_M", (0.0, 3.0))
    monkeypatch.setattr(relit, "WAYS", relit.WAYS[:1])
    told = (
        CliRunner()
        .invoke(relit.main, [str(tmp_path / "run"), "--grid", "1"], catch_exceptions=False)
        .output.splitlines()
    )
    own, here, away, alike, others = ([float(figure) for figure in line.split("|")[2:4]] for line in told[-5:])
    assert own == pytest.approx([scores[look]["psnr"] for look in ("zero_shot", "refined")], abs=0.3)
    assert own == here != away != alike != others and all(8 < figure < own[1] for figure in (*away, *alike, *others))


def test_a_moved_camera_and_its_ground_truth_show_the_same_view():
    truth = json.loads((PLAZA / "truth" / "looks.json").read_text())
    collection = load_collection(PLAZA)
    photo = collection.photos[0]
    taken = truth["photos"][Path(photo.name).stem]["camera"]
    place = relit.standpoint(
        SimpleNamespace(collection=collection, camera=lambda photo: photo.camera), photo.name, taken
    )
    corners = np.array([(-8.0, 0, 1), (8, 0, 1), (0, 0, 15), (0, 20, 20)])  # metres
    in_scene = collection.frame.to_scene(to_model(corners))
    for there in [place, *relit.moved(place, 8.0, truth["model"]["scale"] / collection.frame.radius)]:
        # Poses are off as real ones are.
        np.testing.assert_allclose(there.camera.project(in_scene)[0], there.view.project(corners)[0], atol=2)
    moves = [there.view.centre - place.view.centre for there in relit.moved(place, 8.0, 1.0)]
    np.testing.assert_allclose(np.linalg.norm(moves, axis=1), 8, rtol=1e-5)
    assert moves[2][2] > 7 and moves[3] @ place.view.world_to_camera[2] == pytest.approx(8, rel=1e-5)  # above, ahead


def test_the_truth_is_moved_to_the_device_of_the_run(monkeypatch):
    place = relit.Standpoint(ring_camera(0.0), None)
    height, width = place.camera.height, place.camera.width
    view = SimpleNamespace(render=lambda look: torch.full((height, width, 3), look).to(DEVICE))
    trained = SimpleNamespace(device=DEVICE, seen_by=lambda _: view)
    monkeypatch.setattr(relit, "lit", lambda *_: np.zeros((height, width, 3), np.float32))
    with elsewhere():
        assert relit.scores(trained, [1.0, 0.1], place, None, None, 1) == pytest.approx([0.0, 20.0], abs=0.2)


def test_the_cameras_with_the_most_similar_views_are_found():
    turned = {"world_to_camera": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]}
    ahead = {"world_to_camera": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}
    taken = {
        f"{name}.png": {"camera": {"centre": [float(place), 0, 0], **ahead}} for place, name in enumerate("abcdefgh")
    }
    taken["b.png"]["camera"] |= turned
    own, alike, others = relit.cameras_beside("a.png", taken)
    assert own == ["a.png"] and alike == ["c.png", "d.png", "e.png"] and others == ["f.png", "g.png", "b.png"]
