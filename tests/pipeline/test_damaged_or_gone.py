"""Photos that are damaged, or gone once the run is trained."""

import json
import re
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from core import pipeline
from core.errors import BadInput
from core.looks.find_look import find_look
from core.looks.trained import load_run
from core.pipeline import training
from tests.heard import Heard
from tests.small import HEIGHT, WIDTH, damage, small_settings, unfinished


def test_a_damaged_photo_is_named_and_the_rest_is_used(small_scene, tmp_path, monkeypatch):
    collection = training.load_collection(small_scene)
    photos = [damage(photo) if photo.name in ("photo_0.png", "photo_2.png") else photo for photo in collection.photos]
    spoilt = replace(collection, photos=tuple(photos))
    monkeypatch.setattr(training, "prepared", lambda *_: spoilt)
    heard = Heard()
    folder = pipeline.train(small_scene, small_settings(steps=1), tmp_path / "a run", heard)
    said = "\n".join(heard.lines)
    for split, name in (("train", "photo_0.png"), ("test", "photo_2.png")):
        assert re.search(
            rf"^! 1 photo of the {split} split that cannot be used: {name} \(ends before .*\)$", said, re.MULTILINE
        )
    assert f"Next: wegs bake --run '{folder}'" in said  # not the newest of ./runs, and with a space
    with pytest.raises(BadInput, match="photo_0.jpg ends before"):
        pipeline.bake_to_file(folder, "photo_0.png", tmp_path / "a.ply")
    heard = Heard()
    results = pipeline.evaluate(folder, report=heard, refine=False)
    assert [view.name for view in results.views] == ["photo_5.png"] and results.test_photos == 2
    assert any(line.startswith("! 1 photo not measured: photo_2.png (") for line in heard.lines)
    assert ": 2 held-out photos, protocol" in heard.lines[0]
    photos[2].path.unlink()
    pipeline.evaluate(folder, report=heard, refine=False)
    assert any(": 1 of 2 held-out photos, protocol" in line for line in heard.lines)


def test_a_run_outlives_its_photos(trained, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(trained[0], folder)
    facts = json.loads((folder / "config.json").read_text())
    facts["scene"] |= {"path": str(tmp_path / "gone"), "from_run": "../gone"}
    (folder / "config.json").write_text(json.dumps(facts))
    pipeline.bake_to_file(folder, "neutral", tmp_path / "a.ply")
    before, after = load_run(trained[0]), load_run(folder)
    photo = before.collection.photos[0]
    gone = after.collection.photos[0]
    assert after.sized_photo(photo).photo is photo  # it is there, whatever became of the scene's folder
    known, read = (tuple(vars(camera).values()) for camera in (before.camera(photo), before.sized_photo(photo).camera))
    assert known == read  # one class of arrays: the very same numbers
    pipeline.interpolate(folder, "neutral", "neutral", 2, tmp_path / "fade")
    # Is in the checkpoint.
    assert torch.equal(*(find_look(live, photo.name, refine=False).colouring.embedding for live in (before, after)))
    for need in (lambda: pipeline.evaluate(folder), lambda: after.sized_photo(gone)):
        with pytest.raises(BadInput, match="gone is gone. Move it back, or write where it is now into .*config.json"):
            need()
    facts["scene"]["path"] = json.loads((trained[0] / "config.json").read_text())["scene"]["path"]  # as the advice says
    (folder / "config.json").write_text(json.dumps(facts))
    again = load_run(folder)
    assert again.sized_photo(again.collection.photos[0]).photo.path == photo.path


def test_a_photo_replaced_by_another_is_reported_and_prevents_a_resume(trained, small_scene, tmp_path):
    scene, folder = shutil.copytree(small_scene, tmp_path / "scene"), shutil.copytree(trained[0], tmp_path / "run")
    facts = json.loads((folder / "config.json").read_text())
    facts["scene"] |= {"path": str(scene), "from_run": None}
    (folder / "config.json").write_text(json.dumps(facts))
    said = "! Photos or their masks changed since this run began, so looks and figures may be wrong: photo_0.png"
    photo = load_run(folder).collection.photos[0]
    for changed in (False, True):
        if changed:
            cv2.imwrite(str(photo.path), np.full((HEIGHT, WIDTH, 3), 7, np.uint8))
        heard = Heard()
        pipeline.bake_to_file(folder, "neutral", tmp_path / "a.ply", heard, force=True)
        assert (said in heard.lines) == changed
    unfinished(folder)
    with pytest.raises(
        BadInput, match="are not those that .* began with; changed, split otherwise or gone: photo_0.png. Put them back"
    ):
        pipeline.resume(folder)


def test_a_run_is_not_resumed_with_masks_that_were_redrawn(small_scene, tmp_path):
    (tmp_path / "masks").mkdir()
    for number in range(5):
        cv2.imwrite(str(tmp_path / "masks" / f"photo_{number}.png"), np.full((HEIGHT, WIDTH), 255, np.uint8))
    folder = pipeline.train(small_scene, small_settings(steps=1), tmp_path / "run", masks=tmp_path / "masks")
    unfinished(folder)
    redrawn = np.full((HEIGHT, WIDTH), 255, np.uint8)
    redrawn[::2, ::3] = 0
    cv2.imwrite(str(tmp_path / "masks" / "photo_1.png"), redrawn)
    with pytest.raises(
        BadInput,
        match="or their masks, are not those that .* changed, split otherwise or gone: photo_1.png. Put them back",
    ):
        pipeline.resume(folder)
