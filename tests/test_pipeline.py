"""The story end to end on six tiny photos: train, stop, go on, bake, interpolate; and what is refused on the way."""

import json
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import core.rasterizer
from core import pipeline
from core.bench import suite
from core.errors import BadInput, BadSetting, WegsError
from core.export.ply import read_ply
from core.looks import held_out_views
from core.training import run
from tests.heard import Heard
from tests.small import damage, give_to_pipeline, small_collection, small_settings

STEPS = 12


@pytest.fixture(scope="module", autouse=True)
def small_scene(tmp_path_factory):
    """`pipeline` finds the small collection, whatever folder it is asked to read."""
    folder = tmp_path_factory.mktemp("scene")
    collection = replace(small_collection(folder), notes=("photo_7.png was dropped: it is empty.",))
    with pytest.MonkeyPatch.context() as patch:
        give_to_pipeline(collection, patch)
        yield folder


@pytest.fixture(scope="module")
def trained(small_scene, tmp_path_factory):
    """A finished run and what was said on the way."""
    heard = Heard()
    output = tmp_path_factory.mktemp("runs") / "small"
    return pipeline.train(small_scene, small_settings(steps=STEPS), output, heard), heard


# --- training


def test_training_tells_what_it_found_and_leaves_a_run_that_viewers_open(trained):
    folder, heard = trained
    said = "\n".join(heard.lines)
    for words in ("6 photos (4 train, 2 test)", "! photo_7.png was dropped", "48x36 px", "held-out PSNR", "Next: wegs bake"):
        assert words in said
    assert heard.steps[:STEPS] == [(step + 1, STEPS) for step in range(STEPS)]
    names = {path.name for path in folder.iterdir()}
    assert {"cfg_args", "cameras.json", "input.ply", "point_cloud", "config.json", "history.csv", "masks"} <= names
    neutral = read_ply(folder / "point_cloud" / f"iteration_{STEPS}" / "point_cloud.ply")
    assert 0 < len(neutral) <= len(pipeline.load_run(folder).splats)
    assert len(list((folder / "masks").iterdir())) == 4


def test_ctrl_c_keeps_the_step_and_the_run_goes_on_as_if_nothing_had_happened(trained, small_scene, tmp_path):
    class Impatient(Heard):
        def progress(self, what, done, total, note=""):
            super().progress(what, done, total, note)
            if done == 5:
                signal.raise_signal(signal.SIGINT)

    whole, folder = pipeline.load_run(trained[0]), tmp_path / "run"
    handler = signal.getsignal(signal.SIGINT)  # a shell that starts this in the background leaves it ignored
    with pytest.raises(KeyboardInterrupt, match="Step 5 is kept.*--resume"):
        pipeline.train(small_scene, small_settings(steps=STEPS), folder, Impatient())
    assert signal.getsignal(signal.SIGINT) is handler
    assert not (folder / "point_cloud").exists()
    with (folder / "history.csv").open("a") as file:
        file.write("9,0.1,400,0.3,0.3,1.0,0.0,\n")  # as if it had gone on and then been killed
    heard = Heard()
    pipeline.resume(folder, heard)
    assert heard.steps[0] == (6, STEPS)
    steps = [[line.split(",")[0] for line in (where / "history.csv").read_text().splitlines()] for where in (trained[0], folder)]
    assert steps[0] == steps[1]
    resumed = pipeline.load_run(folder)
    for name, tensor in whole.splats.tensors().items():
        assert torch.equal(getattr(resumed.splats, name), tensor), name
    with pytest.raises(BadInput, match="is finished: 12 steps.* train a new run with --steps"):
        pipeline.resume(folder)
    shutil.rmtree(folder / "point_cloud")  # as if it had been killed after its last step
    pipeline.resume(folder)
    assert (folder / "point_cloud" / f"iteration_{STEPS}" / "point_cloud.ply").is_file()


def test_a_run_is_not_resumed_with_other_photos(small_scene, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    collection = pipeline.load_collection(small_scene)
    run.create(folder, collection, small_settings())
    fewer = replace(collection, photos=collection.photos[1:])
    monkeypatch.setattr(pipeline, "load_collection", lambda *_: fewer)
    monkeypatch.setattr(pipeline.checkpoint, "newest", lambda folder: folder / "checkpoint")
    monkeypatch.setattr(pipeline.checkpoint, "load", lambda path: pipeline.checkpoint.Checkpoint({}, {"step": 1}))
    with pytest.raises(BadInput, match="not those that .* began with: photo_0.png differ or are gone. Put them back"):
        pipeline.resume(folder)


def test_nothing_is_written_when_training_is_refused(small_scene, tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    output = tmp_path / "run"
    refused = [({"device": "cuda"}, "finds no NVIDIA GPU"), *(({"resolution": width}, "-r 1") for width in (0, 3, 15))]
    for changes, word in refused:
        with pytest.raises(BadSetting, match=word):
            pipeline.train(small_scene, small_settings(**changes), output)
    assert list(tmp_path.iterdir()) == []


# --- baking


def test_the_ply_of_a_look_shows_what_the_live_model_shows(trained, tmp_path):
    live = pipeline.load_run(trained[0])
    photo = live.collection.photos[0]
    rasterizer = core.rasterizer.create("auto")
    camera = live.picture(photo).camera
    for word in ("neutral", "photo_0.png", "photo_2.png"):
        path = pipeline.export(trained[0], word, tmp_path / f"{word}.ply")
        look = pipeline.find_appearance(live, word)
        with torch.no_grad():
            expected = live.seen_by(camera)(look.embedding, look.tone)
        baked = rasterizer.render(read_ply(path).in_scene(live.collection.frame), camera).image
        assert (baked - expected).abs().max() <= 0.5 / 255  # half an 8-bit step: no viewer can show the difference


def test_looks_differ_and_can_be_kept_by_name(trained, tmp_path):
    folder = trained[0]
    data = {}
    for name, word, save_as in (("a", "photo_0.png", "noon"), ("b", "noon", None), ("c", "photo_4.png", None)):
        pipeline.export(folder, word, tmp_path / f"{name}.ply", save_as=save_as)
        data[name] = read_ply(tmp_path / f"{name}.ply").sh
    assert torch.equal(data["a"], data["b"]) and not torch.equal(data["a"], data["c"])
    live = pipeline.load_run(folder)
    with pytest.raises(BadInput, match="a name such as noon"):
        pipeline.find_appearance(live, "Noo")
    by_path = pipeline.find_appearance(live, str(folder / "appearance" / "noon.json"))
    assert by_path.source == "training photo photo_0.png"
    for elsewhere, words in (("gone/noon", "is neither a photo file"), ("gone/noon.json", "no saved look gone/noon.json")):
        with pytest.raises(BadInput, match=words):
            pipeline.find_appearance(live, elsewhere)


def test_a_photo_of_the_collection_is_known_by_its_path_and_others_are_from_outside(trained, small_scene, tmp_path):
    live = pipeline.load_run(trained[0])
    known = pipeline.find_appearance(live, str(small_scene / "photo_0.png"))
    assert known.source == "training photo photo_0.png"
    copy = tmp_path / "copy.png"
    copy.write_bytes((small_scene / "photo_0.png").read_bytes())
    outside = pipeline.find_appearance(live, str(copy), refine=False)
    assert outside.source == "photo copy.png from outside the collection"
    assert "held-out" in pipeline.find_appearance(live, "photo_2.png").source


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
def test_a_look_that_is_none_is_refused_and_nothing_is_written(trained, tmp_path, monkeypatch, word, words):
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("tiny.png", np.zeros((1, 1, 3), np.uint8))
    Path("text.png").write_text("not a photo")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(BadInput, match=words):
        pipeline.export(trained[0], word, Path("a.ply"))
    assert sorted(tmp_path.iterdir()) == before


def test_an_output_that_exists_or_has_no_format_is_refused(trained, tmp_path):
    path = tmp_path / "a.ply"
    path.write_text("old")
    with pytest.raises(BadInput, match="--force"):
        pipeline.export(trained[0], "neutral", path)
    with pytest.raises(BadInput, match=".ply"):
        pipeline.export(trained[0], "neutral", tmp_path / "a.obj")
    assert path.read_text() == "old"
    pipeline.export(trained[0], "neutral", path, force=True)
    assert len(read_ply(path)) > 0


def test_a_table_of_embeddings_knows_no_other_photos(small_scene, tmp_path):
    folder = pipeline.train(small_scene, small_settings(steps=2, embedding="glo"), tmp_path / "run")
    pipeline.export(folder, "photo_0.png", tmp_path / "a.ply")
    with pytest.raises(BadInput, match="embedding=glo"):
        pipeline.export(folder, "photo_2.png", tmp_path / "b.ply")


# --- interpolating


def test_the_ends_of_a_fade_are_the_two_bakes_bit_for_bit(trained, tmp_path):
    folder, ends = trained[0], ("neutral", "photo_4.png")
    output = pipeline.interpolate(folder, *ends, steps=3, output=tmp_path / "fade", ply=True)
    assert sorted(path.name for path in output.iterdir()) == [
        *(f"frame_{step:03d}.png" for step in range(3)),
        "sheet.png",
        *(f"step_{step:03d}.ply" for step in range(3)),
        "video.mp4",
    ]
    live = pipeline.load_run(folder)
    camera = live.picture(live.collection.split("test")[0]).camera
    for word, step in zip(ends, (0, 2), strict=True):
        pipeline.export(folder, word, tmp_path / "end.ply", force=True)
        assert (tmp_path / "end.ply").read_bytes() == (output / f"step_{step:03d}.ply").read_bytes()
        baked = pipeline.bake(live, pipeline.find_appearance(live, word))
        image = core.rasterizer.create("auto").render(baked, camera).image
        frame = cv2.imread(str(output / f"frame_{step:03d}.png"))[..., ::-1]
        np.testing.assert_array_equal(frame, (image.clamp(0, 1) * 255).round().byte().numpy())
    ends_sh = [read_ply(output / f"step_{step:03d}.ply").sh for step in (0, 1, 2)]
    assert not torch.equal(ends_sh[1], ends_sh[0]) and not torch.equal(ends_sh[1], ends_sh[2])


def test_a_fade_whose_video_fails_keeps_its_frames(trained, tmp_path, monkeypatch):
    def full(path, _):
        raise WegsError(f"The disk is full: {path} was not written.", "Free some space.")

    monkeypatch.setattr(pipeline, "write_video", full)
    output = pipeline.interpolate(trained[0], "neutral", "photo_4.png", 2, tmp_path / "fade", heard := Heard())
    assert sorted(path.name for path in output.iterdir()) == ["frame_000.png", "frame_001.png", "sheet.png"]
    warning = f"! The disk is full: {output / 'video.mp4'} was not written. Free some space."
    assert heard.lines[-2:] == [warning, f"{output}: 2 frames, sheet.png"]


def test_a_view_or_an_output_that_cannot_be_is_refused_before_the_work(trained, tmp_path, monkeypatch):
    monkeypatch.setattr(pipeline, "find_appearance", None)  # as any work would fail
    with pytest.raises(BadInput, match="no photo bogus"):
        pipeline.interpolate(trained[0], "neutral", "photo_0.png", 2, tmp_path / "fade", view="bogus")
    monkeypatch.chdir(tmp_path)
    Path("photo_0-to-dusk.2").symlink_to("gone")
    with pytest.raises(BadInput, match="photo_0-to-dusk.2 is not a folder"):
        pipeline.interpolate(trained[0], "photo_0.png", "looks/dusk.2.json", 2)


# --- measuring


def test_evaluation_writes_figures_and_a_sheet(trained, tmp_path):
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
    pipeline.evaluate(trained[0], "full", refine=False, keep_pictures=True)  # neither protocol's figures replace the other's
    for name, protocol in (("results.json", "half"), ("results_full.json", "full")):
        assert json.loads((trained[0] / name).read_text())["protocol"] == protocol
    assert {path.name for path in trained[0].glob("*_full.*")} == {"per_view_full.json", "results_full.json", "sheet_full.png"}
    assert {path.name for path in (trained[0] / "pictures/full/gt-color").iterdir()} == {"photo_2.png", "photo_5.png"}


def test_a_photo_without_a_pixel_to_score_enters_no_mean(trained, monkeypatch):
    def view_of(live, photo):
        view = held_out_view(live, photo)
        return replace(view, valid=torch.full(view.picture.shape[:2], photo.name != "photo_2.png"))

    held_out_view = held_out_views.held_out_view
    monkeypatch.setattr(held_out_views, "held_out_view", view_of)
    results = pipeline.evaluate(trained[0], refine=False)
    assert len(results.views) == 1 and np.isfinite(results.means()["photo"]["zero_shot"]["psnr"])


def test_a_run_without_held_out_photos_is_not_evaluated(small_scene, tmp_path, monkeypatch):
    collection = pipeline.load_collection(small_scene)
    only = replace(collection, photos=collection.split("train"))
    monkeypatch.setattr(pipeline, "prepared", lambda *_: only)
    folder = pipeline.train(small_scene, small_settings(steps=1), tmp_path / "run")
    with pytest.raises(BadInput, match="no held-out photos"):
        pipeline.evaluate(folder)


# --- photos that are damaged, or gone


def test_a_damaged_photo_is_named_and_the_rest_is_used(small_scene, tmp_path, monkeypatch):
    collection = pipeline.load_collection(small_scene)
    photos = [damage(photo) if photo.name in ("photo_0.png", "photo_2.png") else photo for photo in collection.photos]
    spoilt = replace(collection, photos=tuple(photos))
    monkeypatch.setattr(pipeline, "prepared", lambda *_: spoilt)
    heard = Heard()
    folder = pipeline.train(small_scene, small_settings(steps=1), tmp_path / "a run", heard)
    said = "\n".join(heard.lines)
    assert "! 1 photo of the train split that cannot be used: photo_0.png" in said and "! 1 photo of the test split that cannot be used: photo_2.png" in said
    assert f"Next: wegs bake --run '{folder}'" in said  # not the newest of ./runs, and with a space
    with pytest.raises(BadInput, match="photo_0.jpg ends before"):
        pipeline.export(folder, "photo_0.png", tmp_path / "a.ply")
    heard = Heard()
    results = pipeline.evaluate(folder, report=heard, refine=False)
    assert [view.name for view in results.views] == ["photo_5.png"] and results.test_photos == 2
    assert any(line.startswith("! 1 photo not measured: photo_2.png (") for line in heard.lines)


def test_a_run_outlives_its_photos(trained, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(trained[0], folder)
    facts = json.loads((folder / "config.json").read_text())
    facts["scene"] |= {"path": str(tmp_path / "gone"), "from_run": "../gone"}
    (folder / "config.json").write_text(json.dumps(facts))
    pipeline.export(folder, "neutral", tmp_path / "a.ply")
    before, after = pipeline.load_run(trained[0]), pipeline.load_run(folder)
    photo = before.collection.photos[0]
    gone = after.collection.photos[0]
    assert after.picture(photo).photo is photo  # it is there, whatever became of the scene's folder
    known, read = (tuple(vars(camera).values()) for camera in (before.camera(photo), before.picture(photo).camera))
    assert known == read  # one class of arrays: the very same numbers
    pipeline.interpolate(folder, "neutral", "neutral", 2, tmp_path / "fade")
    assert torch.equal(*(pipeline.find_appearance(live, photo.name).embedding for live in (before, after)))  # is in the checkpoint
    for need in (lambda: pipeline.evaluate(folder), lambda: after.picture(gone)):
        with pytest.raises(BadInput, match="gone is gone. Move the photos back"):
            need()


def test_a_look_that_was_kept_is_not_replaced_without_force(trained, tmp_path):
    pipeline.export(trained[0], "photo_0.png", tmp_path / "a.ply", save_as="kept")
    path = trained[0] / "appearance" / "kept.json"
    before = path.read_text()
    with pytest.raises(BadInput, match="kept.json exists.*--force"):
        pipeline.export(trained[0], "photo_4.png", tmp_path / "b.ply", save_as="kept")
    with pytest.raises(BadSetting, match="is the name of a photo"):
        pipeline.export(trained[0], "photo_4.png", tmp_path / "b.ply", save_as="photo_0.png", force=True)
    assert path.read_text() == before and not (tmp_path / "b.ply").exists()
    pipeline.export(trained[0], "photo_4.png", tmp_path / "b.ply", save_as="kept", force=True)
    assert path.read_text() != before


def test_a_run_that_may_not_be_written_in_is_refused_before_the_work(trained, tmp_path, monkeypatch):
    monkeypatch.setattr(pipeline, "find_appearance", None)  # as any work would fail
    monkeypatch.setattr(pipeline, "measure", None)
    monkeypatch.setattr("os.access", lambda path, mode: trained[0] not in (Path(path), Path(path).parent))
    for need in (
        lambda: pipeline.evaluate(trained[0]),
        lambda: pipeline.export(trained[0], "neutral", tmp_path / "a.ply", save_as="new"),
        lambda: suite.curves((trained[0],), ("half",), True, Heard()),
    ):
        with pytest.raises(BadInput, match="may not be written in. Make it writable, or copy the run"):
            need()
    assert list(tmp_path.iterdir()) == []
