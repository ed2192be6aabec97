"""Figures of the photos that were held out, and runs that have none to give."""

import errno
import json
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from core import pipeline
from core.bench import suite
from core.errors import BadInput, BadSetting, WegsError, disk_full
from core.evaluation import lpips, protocols
from core.evaluation.lpips import Lpips
from core.looks import held_out_views
from core.looks.trained import load_run
from core.pipeline import baking, evaluating
from core.run import checkpoint
from core.run.claim import held
from tests.evaluation.test_lpips import made_weights
from tests.failing import failing
from tests.heard import Heard
from tests.pipeline.conftest import STEPS
from tests.small import damage


def test_evaluation_writes_figures_and_a_sheet(trained):
    heard = Heard()
    results = pipeline.evaluate(trained[0], "half", heard, refine=False)
    assert (results.train_photos, results.test_photos, results.steps, results.scale) == (4, 2, STEPS, 1.0)
    assert [view.name for view in results.views] == ["photo_2.png", "photo_5.png"]
    written = json.loads((trained[0] / "results.json").read_text())
    assert written["protocol"] == "half" and written["training_seconds"] > 0
    assert written["means"]["photo"]["zero_shot"]["psnr"] == results.means()["photo"]["zero_shot"]["psnr"]
    assert len(json.loads((trained[0] / "per_view.json").read_text())) == 2
    assert cv2.imread(str(trained[0] / "sheet.png")).shape[1] > 4 * 48  # photo | render | mask | error
    assert heard.steps[-1] == (2, 2) and any(line.startswith("photo, zero-shot: PSNR") for line in heard.lines)
    # Neither protocol's figures replace the other's.
    pipeline.evaluate(trained[0], "full", refine=False, keep_pictures=True)
    for name, protocol in (("results.json", "half"), ("results_full.json", "full")):
        assert json.loads((trained[0] / name).read_text())["protocol"] == protocol
    assert {path.name for path in trained[0].glob("*_full.*")} == {
        "per_view_full.json",
        "results_full.json",
        "sheet_full.png",
    }
    assert {path.name for path in (trained[0] / "pictures/full/gt-color").iterdir()} == {"photo_2.png", "photo_5.png"}


def test_the_sheet_shows_some_of_many_photos_and_says_so(trained, monkeypatch):
    pipeline.evaluate(trained[0], refine=False)
    height = cv2.imread(str(trained[0] / "sheet.png")).shape[0]
    monkeypatch.setattr(evaluating, "MOST_ROWS", 1)
    heard = Heard()
    results = pipeline.evaluate(trained[0], report=heard, refine=False)
    assert cv2.imread(str(trained[0] / "sheet.png")).shape[0] < height and len(results.views) == 2
    assert heard.lines[-1].endswith("per_view.json, sheet.png (of 1 photo)")


def test_the_sheet_shows_photos_that_can_be_read(trained, tmp_path, monkeypatch):
    monkeypatch.setattr(evaluating, "MOST_ROWS", 1)
    live, heard = load_run(trained[0]), Heard()
    first = next(photo for photo in live.collection.photos if photo.split == "test")
    for lost in (replace(first, path=tmp_path / "gone.png"), damage(first)):
        photos = tuple(lost if photo is first else photo for photo in live.collection.photos)
        broken = replace(live, collection=replace(live.collection, photos=photos))
        monkeypatch.setattr(evaluating, "open_run", lambda *_, broken=broken: broken)
        assert len(pipeline.evaluate(trained[0], report=heard, refine=False).views) == 1
    assert sum(line.endswith("per_view.json, sheet.png") for line in heard.lines) == 2


def test_pictures_of_an_earlier_call_are_reported_as_such(trained, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(trained[0], folder, ignore=shutil.ignore_patterns("pictures"))
    told = []
    for protocol, keep in (("half", True), ("full", False), ("half", False), ("half", True)):
        heard = Heard()
        pipeline.evaluate(folder, protocol, heard, refine=False, keep_pictures=keep)
        told.append([line for line in heard.lines if "earlier call" in line])
    assert told == [[], [], [f"! {folder / 'pictures' / 'half'} is of an earlier call: --pictures replaces it"], []]


def test_the_known_truth_of_a_synthetic_scene_is_measured_too(trained, small_scene, monkeypatch):
    """The photos themselves as the clean truth, nobody in them; and of photos too small for LPIPS that is said."""
    monkeypatch.setattr(lpips, "load", lambda device: Lpips(made_weights()).to(device))
    for kind in ("clean", "masks"):
        (small_scene / "truth" / kind).mkdir(parents=True)
    for name in ("photo_2.png", "photo_5.png"):
        shutil.copy(small_scene / name, small_scene / "truth" / "clean" / name)
        cv2.imwrite(str(small_scene / "truth" / "masks" / name), np.full((36, 48), 255, np.uint8))
    heard = Heard()
    results = pipeline.evaluate(trained[0], "half", heard, refine=False)
    means = results.means()
    shutil.rmtree(small_scene / "truth")
    assert results.lpips_backbone == lpips.BACKBONE
    assert means["photo"]["zero_shot"] == means["clean_right"]["zero_shot"] != means["clean"]["zero_shot"]
    assert (
        any(line.startswith("mask IoU: ") for line in heard.lines) and "LPIPS: 2 photos too small for it" in heard.lines
    )


def test_without_the_weights_of_lpips_the_rest_is_measured(trained, monkeypatch):
    monkeypatch.setattr(lpips, "load", lambda device: None)
    results = pipeline.evaluate(trained[0], report=(heard := Heard()), refine=False)
    means = results.means()["photo"]["zero_shot"]
    assert (results.lpips_backbone, means["lpips"]) == (None, None) and means["psnr"] > 0
    assert [line for line in heard.lines if "LPIPS: " in line] == [f"! LPIPS: {lpips.ABSENT}"]


def test_a_photo_without_a_pixel_to_score_enters_no_mean(trained, monkeypatch):
    def view_of(live, photo):
        view = held_out_view(live, photo)
        return replace(view, valid=torch.full(view.picture.shape[:2], photo.name != "photo_2.png"))

    held_out_view = held_out_views.held_out_view
    monkeypatch.setattr(held_out_views, "held_out_view", view_of)
    results = pipeline.evaluate(trained[0], refine=False)
    assert len(results.views) == 1 and np.isfinite(results.means()["photo"]["zero_shot"]["psnr"])


def test_a_run_that_may_not_be_written_in_is_refused_before_the_work(trained, tmp_path, monkeypatch):
    monkeypatch.setattr(baking, "find_look", None)  # as any work would fail
    monkeypatch.setattr(evaluating, "measure", None)
    make = tempfile.mkdtemp

    def refuse_in_run(dir=None, **options):
        if trained[0] in (Path(dir), Path(dir).parent):
            raise PermissionError(errno.EACCES, "Permission denied", dir)
        return make(dir=dir, **options)

    monkeypatch.setattr("tempfile.mkdtemp", refuse_in_run)
    for need in (
        lambda: pipeline.evaluate(trained[0]),
        lambda: pipeline.bake_to_file(trained[0], "neutral", tmp_path / "a.ply", save_as="new"),
        lambda: suite.curves((trained[0],), ("half",), True, Heard()),
    ):
        with pytest.raises(
            BadInput, match="may not be written in: Permission denied. Make it writable, or copy the run"
        ):
            need()
    assert list(tmp_path.iterdir()) == []


def test_every_command_says_if_a_run_was_stopped(trained, tmp_path, few_steps):
    folder = tmp_path / "run"
    shutil.copytree(trained[0], folder)
    saved = checkpoint.load(checkpoint.newest(folder))
    for path in checkpoint.written(folder):
        path.unlink()
    checkpoint.save(folder, checkpoint.Checkpoint(saved.tensors, saved.facts | {"step": 5}))
    heard = Heard()
    pipeline.evaluate(folder, report=heard, refine=False)
    pipeline.bake_to_file(folder, "neutral", tmp_path / "a.ply", heard)
    pipeline.interpolate(folder, "neutral", "photo_0.png", 2, tmp_path / "fade", heard)
    told = f"! {folder} was stopped; wegs train --resume -o {folder} goes on: this is step 5 of {STEPS}."
    assert heard.lines.count(told) == 3
    heard = Heard()
    with held(folder):
        pipeline.bake_to_file(folder, "neutral", tmp_path / "b.ply", heard)
    assert heard.lines[0] == f"! {folder} is still being trained: this is step 5 of {STEPS}."


def test_an_unknown_protocol_is_refused_before_the_run_is_read(tmp_path):
    with pytest.raises(BadSetting, match="^There is no protocol 'whole'. Choose one of: half, full.$"):
        pipeline.evaluate(tmp_path / "no run", "whole")


def test_a_folder_in_place_of_the_results_is_refused_before_the_work(trained, tmp_path, monkeypatch):
    folder = shutil.copytree(trained[0], tmp_path / "run", ignore=shutil.ignore_patterns("results.json"))
    (folder / "results.json").mkdir()
    monkeypatch.setattr(evaluating, "measure", None)  # as any work would fail
    with pytest.raises(BadInput, match="results.json is a folder, where a file is to be written. Move it away."):
        pipeline.evaluate(folder)


def test_figures_of_a_run_that_was_replaced_meanwhile_are_not_kept(trained, tmp_path, monkeypatch):
    folder = shutil.copytree(trained[0], tmp_path / "run", ignore=shutil.ignore_patterns("*.json", "pictures"))
    config = folder / "config.json"
    config.write_bytes((trained[0] / config.name).read_bytes())

    def replaced(*arguments):
        config.write_text('{"run": "another"}')
        return protocols.measure(*arguments)

    monkeypatch.setattr(evaluating, "measure", replaced)
    with pytest.raises(BadInput, match="holds another run than before. Run the same command again."):
        pipeline.evaluate(folder, refine=False, keep_pictures=True)
    assert not any((folder / name).exists() for name in ("results.json", "per_view.json", "pictures"))


@pytest.mark.parametrize(
    "keep_pictures, words", [(False, "was moved or removed meanwhile"), (True, "could not be written")]
)
def test_figures_of_a_run_that_was_renamed_meanwhile_do_not_make_a_folder_of_its_old_name(
    trained, tmp_path, monkeypatch, keep_pictures, words
):
    folder = shutil.copytree(trained[0], tmp_path / "run", ignore=shutil.ignore_patterns("results.json"))

    def renamed(*arguments):
        if folder.exists():
            folder.rename(tmp_path / "renamed")
        return protocols.measure(*arguments)

    monkeypatch.setattr(evaluating, "measure", renamed)
    with pytest.raises(BadInput, match=f"^{folder}.* {words}"):
        pipeline.evaluate(folder, refine=False, keep_pictures=keep_pictures)
    assert [path.name for path in tmp_path.iterdir()] == ["renamed"]
    assert not (tmp_path / "renamed" / "results.json").exists()


def test_figures_are_printed_even_if_the_disk_is_full(trained, monkeypatch):
    monkeypatch.setattr(evaluating, "write_png", failing(disk_full("sheet.png")))
    heard = Heard()
    with pytest.raises(WegsError, match="disk is full"):
        pipeline.evaluate(trained[0], report=heard, refine=False)
    assert any(line.startswith("photo, zero-shot: PSNR") for line in heard.lines)
