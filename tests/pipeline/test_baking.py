"""A trained run in one look as a file: which look, and what is refused."""

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch

import core.rasterizer
from core import pipeline
from core.errors import BadInput, BadSetting
from core.export.ply import read_ply
from core.looks.find_look import find_look
from core.looks.pruning import Pruned, Pruner
from core.looks.trained import load_run
from core.pipeline import baking
from core.scene.frame import SceneFrame
from tests.heard import Heard
from tests.small import small_settings, unfinished


def test_the_ply_of_a_look_shows_what_the_live_model_shows(trained, tmp_path):
    live = load_run(trained[0])
    photo = live.collection.photos[0]
    rasterizer = core.rasterizer.create("auto")
    camera = live.sized_photo(photo).camera
    for word in ("neutral", "photo_0.png", "photo_2.png"):
        path = pipeline.bake_to_file(trained[0], word, tmp_path / f"{word}.ply")
        look = find_look(live, word)
        with torch.no_grad():
            expected = live.seen_by(camera).render(look.colouring)
        baked = rasterizer.render(read_ply(path).in_scene(live.collection.frame), camera)
        assert (baked - expected).abs().max() <= 0.5 / 255  # half an 8-bit step: no viewer can show the difference


def test_viewpoints_are_mentioned_if_they_exist_and_written_again_on_resume(trained, tmp_path):
    folder = shutil.copytree(trained[0], tmp_path / "run")
    cameras = (folder / "cameras.json").read_bytes()
    for gone in (False, True):
        if gone:
            (folder / "cameras.json").unlink()
        heard = Heard()
        pipeline.bake_to_file(folder, "neutral", tmp_path / "a.ply", heard, force=True)
        assert any("cameras.json as well" in line for line in heard.lines) != gone
    pipeline.resume(unfinished(folder))
    assert (folder / "cameras.json").read_bytes() == cameras


def test_what_no_view_would_miss_is_left_out_unless_all_is_kept(trained, tmp_path, monkeypatch):
    monkeypatch.setattr(Pruner, "__call__", lambda _, baked: Pruned(baked, gaussians=7))
    for prune in (True, False):
        pipeline.bake_to_file(trained[0], "neutral", tmp_path / f"{prune}.ply", heard := Heard(), prune=prune)
        assert any(line.startswith("Left out 7 Gaussians") for line in heard.lines) == prune


def test_a_file_that_was_made_meanwhile_is_not_replaced(trained, tmp_path, monkeypatch):
    def made(*arguments):
        (tmp_path / "a.ply").write_text("theirs")
        return find_look(*arguments)

    monkeypatch.setattr(baking, "find_look", made)
    with pytest.raises(BadInput, match="a.ply exists. Add --force"):
        pipeline.bake_to_file(trained[0], "neutral", tmp_path / "a.ply")
    assert (tmp_path / "a.ply").read_text() == "theirs"


def test_looks_differ_and_can_be_kept_by_name(trained, tmp_path, few_steps, monkeypatch):
    folder = trained[0]
    data = {}
    for name, word, save_as in (("a", "photo_0.png", "noon"), ("b", "noon", None), ("c", "photo_4.png", None)):
        pipeline.bake_to_file(folder, word, tmp_path / f"{name}.ply", save_as=save_as)
        data[name] = read_ply(tmp_path / f"{name}.ply").sh
    assert torch.equal(data["a"], data["b"]) and not torch.equal(data["a"], data["c"])
    live = load_run(folder)
    with pytest.raises(BadInput, match="a name such as noon"):
        find_look(live, "Noo")
    by_path = find_look(live, str(folder / "appearance" / "noon.json"))
    assert by_path.source == "saved look noon (of training photo photo_0.png, refined)"
    monkeypatch.chdir(tmp_path)
    shutil.copyfile(folder / "appearance" / "noon.json", "copy.json")
    assert [find_look(live, word).name for word in ("copy.json", "noon.json")] == ["copy", "noon"]  # here; in the run
    for elsewhere, words in (
        ("gone/noon", "is neither a photo file"),
        ("gone/noon.json", "no saved look gone/noon.json"),
    ):
        with pytest.raises(BadInput, match=words):
            find_look(live, elsewhere)


@pytest.mark.parametrize(
    "word, words",
    [
        ("photo_00.png", "such as photo_0.png"),
        ("none.json", "no saved look"),
        ("tiny.png", "1 x 1 px"),
        ("text.png", "text.png"),
        (".", "is a folder, not a photo"),
        (" ", "no name"),
    ],
)
def test_an_unusable_look_is_refused_and_nothing_is_written(trained, tmp_path, monkeypatch, word, words):
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("tiny.png", np.zeros((1, 1, 3), np.uint8))
    Path("text.png").write_text("not a photo")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(BadInput, match=words):
        pipeline.bake_to_file(trained[0], word, Path("a.ply"))
    assert sorted(tmp_path.iterdir()) == before


def test_an_output_that_exists_or_has_no_format_is_refused_before_the_work(trained, tmp_path, monkeypatch):
    path = tmp_path / "a.ply"
    path.write_text("old")
    (tmp_path / "link.ply").symlink_to(tmp_path / "nothing.ply")
    with monkeypatch.context() as patch:
        patch.setattr(baking, "find_look", None)  # as any work would fail
        for name, words in (("a.ply", "--force"), ("a.obj", ".ply"), ("link.ply", "--force")):
            with pytest.raises(BadInput, match=words):
                pipeline.bake_to_file(trained[0], "neutral", tmp_path / name)
    assert path.read_text() == "old"
    pipeline.bake_to_file(trained[0], "neutral", path, force=True)
    assert len(read_ply(path)) > 0


def test_the_reported_seconds_include_finding_the_look(trained, tmp_path, monkeypatch):
    def slowly(*arguments):
        clock[0] += 7
        return find_look(*arguments)

    clock, heard = [0.0], Heard()
    monkeypatch.setattr(baking, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    monkeypatch.setattr(baking, "find_look", slowly)
    path = pipeline.bake_to_file(trained[0], "neutral", tmp_path / "a.ply", heard)
    assert [line.endswith(" MB, 7.0 s") for line in heard.lines if line.startswith(f"{path}: ")] == [True]


def test_a_scene_far_from_the_origin_is_written_around_itself_and_that_is_reported(trained, tmp_path, monkeypatch):
    live, heard, near = load_run(trained[0]), Heard(), Heard()
    pipeline.bake_to_file(trained[0], "neutral", tmp_path / "near.ply", near)
    far = replace(live, collection=replace(live.collection, frame=SceneFrame(np.array([5e6, 0, -7.5]), 1.0)))
    monkeypatch.setattr(baking, "open_run", lambda *_: far)
    pipeline.bake_to_file(trained[0], "neutral", tmp_path / "far.ply", heard)
    assert [line for line in heard.lines if "written around" in line] == far.collection.frame.offset_lines()
    assert heard.lines[1].endswith(": files are written around (5000000, 0, -7.5).") and not any(
        "written around" in line for line in near.lines
    )
    assert torch.equal(*(read_ply(tmp_path / f"{name}.ply").means for name in ("near", "far")))


def test_a_table_of_embeddings_knows_no_other_photos(small_scene, tmp_path, few_steps):
    folder = pipeline.train(small_scene, small_settings(steps=2, embedding="glo"), tmp_path / "run")
    pipeline.bake_to_file(folder, "photo_0.png", tmp_path / "a.ply")
    with pytest.raises(BadInput, match="embedding=glo"):
        pipeline.bake_to_file(folder, "photo_2.png", tmp_path / "b.ply")


def test_a_look_that_was_kept_is_not_replaced_without_force(trained, tmp_path):
    pipeline.bake_to_file(trained[0], "photo_0.png", tmp_path / "a.ply", save_as="kept", refine=False)
    path = trained[0] / "appearance" / "kept.json"
    before = path.read_text()
    with pytest.raises(BadInput, match="kept.json exists.*--force"):
        pipeline.bake_to_file(trained[0], "photo_4.png", tmp_path / "b.ply", save_as="kept", refine=False)
    for name in ("photo_0.png", "photo_0"):
        with pytest.raises(BadSetting, match="is the name of a photo"):
            pipeline.bake_to_file(trained[0], "photo_4.png", tmp_path / "b.ply", save_as=name, force=True)
    assert path.read_text() == before and not (tmp_path / "b.ply").exists()
    pipeline.bake_to_file(trained[0], "photo_4.png", tmp_path / "b.ply", save_as="kept", force=True, refine=False)
    assert path.read_text() != before
