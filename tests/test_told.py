"""What the user is told on the way from photos to looks and figures:
only what is true, in words that a newcomer knows."""

from dataclasses import replace

import pytest
import torch

from core import pipeline
from core.automatic import budget
from core.data import load_collection
from core.pipeline.opened import ONE_LOOK
from core.system import device
from core.training.tell import tell_collection, tell_plan
from core.training.trainer import Trainer
from tests.data.small_scene import SmallScene
from tests.heard import Heard
from tests.small import finished, small_collection, small_settings


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a run with one held-out photo."""
    collection = small_collection(tmp_path_factory.mktemp("scene"), photos=5)
    return finished(collection, small_settings(steps=1), tmp_path_factory.mktemp("runs") / "small").folder


def told(collection) -> list[str]:
    heard = Heard()
    tell_collection(collection, heard)
    return heard.lines


def test_a_single_photo_or_point_is_counted_in_the_singular(trained, tmp_path):
    heard = Heard()
    pipeline.evaluate(trained, "full", heard, refine=False)
    assert heard.lines[0].endswith("step 1: 1 held-out photo, protocol full")
    collection = small_collection(tmp_path)
    assert told(replace(collection, points=collection.points[:1]))[0].endswith("(4 train, 2 test), 1 point")


def test_with_all_photos_the_summary_names_no_held_out_photo(tmp_path):
    scene = SmallScene().write(tmp_path / "scene")
    (scene / "images" / "photo_0.png").write_bytes((scene / "images" / "photo_1.png").read_bytes())
    collection = load_collection(scene)
    assert "every 8th photo" in (said := "\n".join(told(collection))) and "held out though a copy" in said
    lines = told(collection.undivided())
    assert lines[0].endswith("4 photos (4 train, 0 test), 20 points")
    assert [line for line in lines if "held" in line] == [
        "! All photos are trained on, none is held out: there will be no held-out quality."
    ]


def test_the_user_is_told_how_many_points_do_not_fit(tmp_path):
    collection = small_collection(tmp_path)
    points = len(collection.points)
    for most, lines in (
        (2 * points, []),
        (
            2 * points - 1,
            [f"It starts from {points - 1} of the {points} points, as half of the Gaussians are for growth"],
        ),
    ):
        heard, trainer = Heard(), Trainer(collection, small_settings(max_gaussians=most), tmp_path)
        tell_plan(trainer, heard)
        assert [line for line in heard.lines if "starts from" in line] == lines
        assert len(trainer.gaussians.splats) - trainer.gaussians.sky_count == min(points, most // 2)


def test_the_user_is_told_how_to_shorten_a_training_that_takes_a_cpu_hours(tmp_path, monkeypatch):
    collection = small_collection(tmp_path)
    line = (
        "That takes a CPU hours; a quarter of both costs little quality: --steps 45937 --max-gaussians 305156 "
        "(for a first look: --preset quick)"
    )
    for photos, lines in ((592, []), (2625, [line])):
        settings = small_settings(**budget(photos, 320 * 240 * photos))
        heard, trainer = Heard(), Trainer(collection, settings, tmp_path)
        tell_plan(trainer, heard)
        assert [line for line in heard.lines if "hours" in line] == lines
        heard, trainer.state.done = Heard(), 1  # resumed, with its own settings
        tell_plan(trainer, heard)
        assert not any("hours" in line for line in heard.lines)
        heard, trainer.state.done, trainer.device = Heard(), 0, torch.device("cuda")
        monkeypatch.setattr(device, "named", lambda _: "a GPU")
        tell_plan(trainer, heard)
        assert not any("hours" in line for line in heard.lines)


def test_after_baking_the_user_is_told_how_to_view_the_look(trained, tmp_path):
    for sky in (True, False):
        heard, path = Heard(), tmp_path / f"{sky}.ply"
        pipeline.bake_to_file(trained, "neutral", path, heard, with_sky=sky)
        drag = f"Next: drag {path} into https://superspl.at/editor, and {trained / 'cameras.json'} as well for the photos' viewpoints"
        outside = "In the viewer you begin outside the dome of the sky: choose a viewpoint, or fly in"
        assert heard.lines[-1 - sky :] == [drag, outside][: 1 + sky]


def test_an_interpolation_reports_each_of_its_looks_on_a_line(trained, tmp_path, few_steps):
    heard = Heard()
    pipeline.interpolate(trained, "neutral", "photo_0", 2, tmp_path / "fade", heard, views=["photo_1"])
    assert heard.lines[0].endswith("small: 2 frames, seen from photo_1.png")
    assert heard.lines[1:3] == [
        "  from the neutral look (mean of the training photos)",
        "  to training photo photo_0.png, refined",
    ]


def test_only_a_run_without_looks_says_that_all_its_looks_are_the_same(trained, tmp_path):
    plain = finished(small_collection(tmp_path), small_settings(steps=1, appearance="off"), tmp_path / "run").folder
    for folder, said in ((trained, False), (plain, True)):
        pipeline.bake_to_file(folder, "neutral", tmp_path / f"{said}.ply", baked := Heard())
        pipeline.interpolate(folder, "neutral", "neutral", 2, tmp_path / f"fade{said}", faded := Heard())
        assert [heard.lines.count(f"! {ONE_LOOK}") for heard in (baked, faded)] == [said, said]
