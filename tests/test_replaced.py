"""--force deletes what an earlier run or fade wrote, and nothing that the user gives to the new one."""

import shutil

import cv2
import numpy as np
import pytest

from core import pipeline
from core.errors import BadInput
from tests.heard import Heard
from tests.small import HEIGHT, WIDTH, give_to_pipeline, small_collection, small_settings


@pytest.fixture
def trained(tmp_path, monkeypatch):
    """A scene, and a run of it that has masks."""
    scene = tmp_path / "scene"
    scene.mkdir()
    give_to_pipeline(small_collection(scene), monkeypatch)
    return scene, pipeline.train(scene, small_settings(steps=2), tmp_path / "run", Heard())


def content(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_masks_and_scenes_in_the_run_that_is_replaced_are_refused(trained):
    scene, run = trained
    before = content(run)
    for given, masks in ((scene, run / "masks"), (run / "masks", None), (run, None)):
        with pytest.raises(BadInput, match="run, whose files are replaced. Choose another -o, or move it out first"):
            pipeline.train(given, small_settings(steps=2), run, Heard(), force=True, masks=masks)
    assert content(run) == before


def test_masks_that_a_link_in_the_run_leads_to_are_refused(trained):
    scene, run = trained
    shutil.move(run / "masks", scene / "masks")
    (run / "masks").symlink_to(scene / "masks")
    with pytest.raises(BadInput, match="run/masks lies in"):
        pipeline.train(scene, small_settings(steps=2), run, Heard(), force=True, masks=run / "masks")
    assert (run / "masks").is_symlink()


def test_a_look_from_a_frame_of_the_fade_that_is_replaced_is_refused(trained, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fade").mkdir()
    cv2.imwrite("fade/frame_000.png", np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
    with pytest.raises(BadInput, match="fade/frame_000.png lies in .*fade, whose files are replaced"):
        pipeline.interpolate(trained[1], "fade/frame_000.png", "neutral", 2, tmp_path / "fade", Heard(), force=True)
    assert content(tmp_path / "fade")
