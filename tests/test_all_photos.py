"""`--all-photos`: what the split holds out is trained on, in a run that went on as in one that never stopped."""

import shutil

import numpy as np
import pytest

from core import pipeline
from core.errors import BadInput
from core.export.pictures import write_png
from core.looks.find_look import find_look
from core.looks.trained import load_run
from core.run import run_config
from tests.data.small_scene import SmallScene
from tests.heard import StopsAtStep
from tests.small import give_to_pipeline, small_collection, small_settings, unfinished


def test_with_all_photos_masks_apply_to_photos_that_are_otherwise_held_out(tmp_path, monkeypatch):
    collection = small_collection(tmp_path)
    give_to_pipeline(collection, monkeypatch)
    (tmp_path / "masks").mkdir()
    for photo in collection.photos:
        size = photo.camera.height, photo.camera.width
        write_png(tmp_path / "masks" / photo.name, np.full(size, 255, np.uint8))
    masks = [
        [photo.mask is not None for photo in run_config.read_config(folder).collection.split("train")]
        for folder in (
            pipeline.train(
                tmp_path, small_settings(steps=1, all_photos=asked), tmp_path / f"run{asked}", masks=tmp_path / "masks"
            )
            for asked in (False, True)
        )
    ]
    assert masks == [[True] * 4, [True] * 6]


def test_with_all_photos_none_is_held_out_and_the_user_is_told(tmp_path, monkeypatch):
    give_to_pipeline(small_collection(tmp_path), monkeypatch)
    heard, folder = StopsAtStep(2), tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        pipeline.train(tmp_path, small_settings(steps=3, all_photos=True), folder, heard)
    said = "\n".join(heard.lines)
    assert "6 photos (6 train, 0 test)" in said and "! All photos are trained on" in said
    pipeline.resume(folder)
    trained = load_run(folder)
    assert len(trained.model.photo_names) == 6 and not run_config.read_config(folder).collection.split("test")
    with pytest.raises(BadInput, match="has no held-out photos. .*without --all-photos"):
        pipeline.evaluate(folder)


def test_with_all_photos_a_scene_whose_list_holds_out_every_photo_can_be_trained_and_resumed(tmp_path):
    scene = SmallScene().write(tmp_path / "scene")
    (scene / "test.txt").write_text("".join(f"photo_{index}.png\n" for index in range(4)))
    with pytest.raises(BadInput, match="test.txt leaves no photo to train on"):
        pipeline.train(scene, small_settings(steps=1), tmp_path / "run")
    folder = pipeline.train(scene, small_settings(steps=1, all_photos=True), tmp_path / "run")
    pipeline.resume(unfinished(folder))
    trained = load_run(folder)
    assert len(trained.model.photo_names) == 4
    outside = shutil.copyfile(trained.collection.photos[0].path, tmp_path / "outside.png")
    assert "its camera could not be located" in find_look(trained, str(outside)).source
