"""Where a Blender scene is transparent it is learned as empty and scored over white;
elsewhere nobody knows what is transparent."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from core import pipeline
from core.config import Settings
from core.data import load_collection
from core.data.photos.pixels import OPAQUE
from core.errors import BadSetting
from core.evaluation.metrics import psnr, quantised
from core.looks.pruning import pruner_of
from core.looks.trained import load_run
from core.run import checkpoint, run_config
from core.run.background import WHITE
from core.training.trainer import Trainer
from tests.heard import Heard
from tests.small import small_collection, small_settings, trained_to_the_end
from tests.training.learned import assert_same, learned
from tests.training.transparent_scene import write_transparent_scene

PLAIN = {"appearance": "off", "transients": "off", "sh_degree": 0, "device": "cpu"}
SMALL = {**PLAIN, "steps": 100, "max_gaussians": 2000, "densify_rounds": 4, "checkpoints": 1}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_transparent_scene(tmp_path_factory.mktemp("scene"))


def trained(scene, folder, **changes) -> Trainer:
    folder.mkdir()
    return trained_to_the_end(Trainer(load_collection(scene), Settings(**SMALL | changes), folder))


def rgba(photo) -> np.ndarray:
    return cv2.imread(str(photo.path), cv2.IMREAD_UNCHANGED)[..., [2, 1, 0, 3]] / 255


# --- what is learned


def shines_through(trainer: Trainer) -> float:
    """Mean transmittance where held-out photos are wholly transparent."""
    shares = []
    for photo in trainer.collection.split("test"):
        covered = trainer.rasterizer.render(trainer.gaussians.splats.detached().marked(slice(None)), photo.camera)[
            ..., 0
        ]
        shares.append(1 - covered.numpy()[rgba(photo)[..., 3] == 0])
    return float(np.concatenate(shares).mean())


def test_the_space_around_the_object_becomes_empty(scene, tmp_path):
    """0.84 of the light pass at the start, because of points where nothing is."""
    assert shines_through(trained(scene, tmp_path / "empty")) > 0.95  # 0.98
    # 0.77: what is not seen is not tidied.
    assert shines_through(trained(scene, tmp_path / "unseen", sky="none", transparency="unseen")) < 0.85


def test_a_resumed_run_equals_an_unbroken_one_bit_for_bit(scene, tmp_path):
    settings = Settings(**SMALL | {"steps": 22, "checkpoints": 2})
    collection, trainers = load_collection(scene), []
    for until in (22, 11):
        trainers.append(Trainer(collection, settings, tmp_path))
        while trainers[-1].state.done < until:
            trainers[-1].step()
    trainers[1].save()
    resumed = Trainer(collection, settings, tmp_path)
    resumed.resume(checkpoint.load(checkpoint.newest(tmp_path)))
    for _ in range(11):
        resumed.step()
    assert_same(learned(resumed), learned(trainers[0]))


def test_small_targets_know_what_is_empty(scene, tmp_path):
    trainer = Trainer(load_collection(scene), Settings(**SMALL), tmp_path)
    sized = trainer.photos[0]
    premultiplied = rgba(sized.photo)[..., :3] * rgba(sized.photo)[..., 3:]
    small = cv2.resize(premultiplied, (sized.camera.width // 4, sized.camera.height // 4), interpolation=cv2.INTER_AREA)
    target = trainer.photos.target(0, 4)[1].over((0.0, 0.0, 0.0))
    np.testing.assert_allclose(target.planes.permute(1, 2, 0).numpy(), small, rtol=0, atol=1.5 / 255)
    assert target.over((1.0, 1.0, 1.0)) is target  # what has a background keeps it


# --- which scenes


def test_photos_of_other_kinds_show_nothing_where_they_are_transparent_and_nothing_is_drawn_for_them(scene, tmp_path):
    collection = replace(load_collection(scene), kind="nerfstudio")
    trainer = Trainer(collection, Settings(**SMALL), tmp_path)
    assert trainer.settings.sky == "dome" and not trainer.settings.transparent_is_empty
    for sized in (*trainer.photos, *trainer.held_out):
        assert sized.empty is None and np.array_equal(sized.valid, rgba(sized.photo)[..., 3] >= OPAQUE / 255)
    trainer.state.order = [0]
    before = trainer.generator.get_state()
    trainer.step()
    assert torch.equal(trainer.generator.get_state(), before)


def test_a_blender_scene_of_opaque_photos_has_a_sky(tmp_path):
    photos = small_collection(tmp_path)
    for given, sky in (("auto", "dome"), ("none", "none")):
        trainer = Trainer(replace(photos, kind="blender"), small_settings().changed(sky=given), tmp_path)
        assert (
            trainer.settings == small_settings(sky=sky, transparency="unseen")
            and not trainer.settings.transparent_is_empty
        )


def test_renders_with_too_little_evidence_get_a_single_look(scene, tmp_path):
    undecided = {name: value for name, value in SMALL.items() if name not in ("appearance", "transients")}
    for transparency, looks in (("auto", "off"), ("unseen", "full")):
        trainer = Trainer(load_collection(scene), Settings(**undecided, transparency=transparency), tmp_path)
        assert (trainer.settings.appearance, trainer.settings.transients) == (looks, "off")
        assert all(decision.figure is None for decision in trainer.decisions)


def test_transparency_can_mean_empty_space_in_any_scene_but_not_under_a_dome(scene, tmp_path):
    collection = replace(load_collection(scene), kind="nerfstudio")
    trainer = Trainer(collection, Settings(**SMALL, transparency="empty"), tmp_path)
    assert (
        trainer.settings.transparent_is_empty and trainer.settings.sky == "none" and trainer.photos[0].empty is not None
    )
    with pytest.raises(BadSetting, match="a dome leaves nothing empty"):
        Settings(transparency="empty", sky="dome")


def test_a_dome_that_is_asked_for_fills_transparent_space(scene, tmp_path):
    trainer = Trainer(load_collection(scene), Settings(**SMALL, sky="dome", sky_gaussians=60), tmp_path)
    assert trainer.gaussians.sky_count == 60 and not trainer.settings.transparent_is_empty
    assert all(sized.empty is None and not sized.valid.all() for sized in trainer.photos)


# --- what is told, measured and shown


@pytest.fixture(scope="module")
def finished(scene, tmp_path_factory):
    heard = Heard()
    folder = tmp_path_factory.mktemp("runs") / "run"
    return pipeline.train(scene, Settings(**SMALL), folder, heard), heard


def test_training_reports_empty_space_once_and_makes_no_sky(finished):
    folder, heard = finished
    assert (
        sum(line.startswith("Transparent pixels are learned as empty space, without a sky") for line in heard.lines)
        == 1
    )
    assert load_run(folder).sky_count == 0 and run_config.read_config(folder).settings.sky == "none"
    assert "white_background=True" in (folder / "cfg_args").read_text()


def test_figures_are_over_white_and_count_every_pixel(finished):
    folder, heard = finished
    results = pipeline.evaluate(folder, "full", heard, refine=False)
    assert json.loads((folder / "results_full.json").read_text())["transparent_pixels"] == "over white"
    assert any(line.endswith("4 held-out photos, protocol full, over white") for line in heard.lines)
    live, decibels = load_run(folder), []
    for photo in live.collection.split("test"):
        pixels = rgba(photo)
        truth = pixels[..., :3] * pixels[..., 3:] + 1 - pixels[..., 3:]
        image = live.rasterizer.render(live.splats, live.camera(photo), (1.0, 1.0, 1.0))
        decibels.append(psnr(quantised(image), quantised(torch.from_numpy(truth))))
    assert results.means()["photo"]["zero_shot"]["psnr"] == pytest.approx(np.mean(decibels), abs=1e-6)
    last = (folder / "history.csv").read_text().splitlines()[-1].split(",")
    assert float(last[-2]) == pytest.approx(np.mean(decibels), abs=0.01)  # of pictures that were not rounded to 8 bits


def test_what_goes_from_a_look_is_judged_over_white(finished):
    assert pruner_of(load_run(finished[0]), Heard()).background == WHITE


def test_frames_are_over_white(finished, tmp_path):
    output = pipeline.interpolate(finished[0], "neutral", "neutral", 2, tmp_path / "frames")
    assert cv2.imread(str(output / "frame_000.png"))[:5, :5].min() > 230  # 251 after so few steps
