"""`wegs bench` and `wegs eval --curve` as a whole, at a size of seconds."""

import json
import os
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from core.appearance import refinement
from core.automatic import scale_rate_for
from core.bench import FIGURES, files, machine, small_scene, suite
from core.bench.training import training_figure
from core.errors import BadInput
from core.looks.find_look import find_look
from core.looks.trained import bake, load_run
from core.presets import PRESETS
from core.report import Report
from core.system import lock
from tests.failing import failing
from tests.heard import Heard
from tests.small import HEIGHT, WIDTH, small_collection, small_settings

TINY = replace(suite.SMALL, share=0.01, gaussians=1200, budget=0.0, views=2, photos=1)


@pytest.fixture(autouse=True)
def tiny(monkeypatch):
    monkeypatch.setattr(suite, "SMALL", TINY)
    monkeypatch.setattr(refinement, "STEPS", 4)
    monkeypatch.setattr(refinement, "LATER_STEPS", 2)


def test_without_a_run_every_preset_is_trained_on_the_built_in_scene(tmp_path):
    figures = suite.bench(None, None, ("training", "baking"), False, tmp_path / "new", Report())
    assert [figure.name for figure in figures] == ["baking", "training"]
    names = {path.name for path in (tmp_path / "new").iterdir()}
    assert names == {name + suffix for name in ("baking", "training") for suffix in (".csv", ".json", ".png")}
    training = json.loads((tmp_path / "new" / "training.json").read_text())
    assert {point["curve"] for point in training["points"]} == set(PRESETS)
    assert all(point["values"]["steps"]["median"] <= 30 for point in training["points"])
    assert {"cpu", "cores", "threads", "wegs", "torch", "numba", "numpy", "seed"} <= set(training["made_on"])


def test_a_run_is_measured_as_it_is(small_run, tmp_path):
    figures = suite.bench(None, small_run, ("training", "refinement"), False, tmp_path, Report())
    assert [figure.name for figure in figures] == ["training", "refinement"]
    assert list(figures[0].curves()) == [small_run.name]
    with pytest.raises(BadInput, match="--force"):
        suite.bench(None, small_run, ("training",), False, tmp_path, Report())
    suite.bench(None, small_run, ("training",), False, tmp_path, Report(), force=True)


def test_rendering_alone_trains_nothing_and_is_of_the_built_in_scene_and_of_a_run(small_run, tmp_path, monkeypatch):
    figure, rendered = training_figure(suite._courses_of([small_run]), "", ()), []

    def drawn(what, splats, cameras, report, seed, budget, name="rendering"):
        rendered.append((what, len(cameras)))
        return replace(figure, name=name)

    monkeypatch.setattr(suite, "rendering_figure", drawn)
    monkeypatch.setattr(suite, "_train", lambda *_: pytest.fail("something was trained"))
    monkeypatch.setattr(files, "draw_png", lambda figure: b"")
    for run, names in ((small_run, {"rendering", "rendering-run"}), (None, {"rendering"})):
        figures = suite.bench(None, run, ("rendering",), False, tmp_path, Report(), force=run is None)
        assert {figure.name for figure in figures} == {path.stem for path in tmp_path.iterdir()} == names
    assert rendered == [("the built-in scene", 2), (small_run.name, TINY.cameras), ("the built-in scene", 2)]


@pytest.mark.parametrize(
    "names, wanted",
    [
        (("baking",), ["default"]),
        (("rendering", "refinement"), ["default"]),
        (("training", "baking"), [name + seed for name in PRESETS for seed in ("", "-1")]),
    ],
)
def test_no_more_is_trained_than_the_figures_need(tmp_path, monkeypatch, names, wanted):
    trained = {}
    monkeypatch.setattr(suite, "_train", lambda _, settings, folder, *__: trained.update({folder.name: settings.seed}))
    collection = small_collection(tmp_path)
    courses, _, _ = suite._train_presets(collection, names, replace(TINY, seeds=2), tmp_path, Report())
    assert list(trained) == ["warm-up", *wanted] == ["warm-up", *(path.name for one in courses for path in one.folders)]
    assert all(seed == name.endswith("-1") for name, seed in trained.items())
    assert [course.name for course in courses if course.is_default] == ["default"]


def test_what_cannot_be_measured_is_refused_before_the_minutes(tmp_path, small_run, monkeypatch):
    monkeypatch.setattr(suite, "rendering_figure", lambda *_, **__: pytest.fail("it was measured first"))
    with pytest.raises(BadInput, match="not a run"):
        suite.bench(None, tmp_path, FIGURES, False, tmp_path / "out", Report())
    with pytest.raises(BadInput, match="no folder"):
        suite.bench(tmp_path / "none", None, FIGURES, False, tmp_path / "out", Report())
    with pytest.raises(BadInput, match="Leave SCENE out"):
        suite.bench(tmp_path, None, ("rendering",), False, tmp_path / "out", Report())
    with pytest.raises(BadInput, match="not a folder"):
        suite.bench(None, None, FIGURES, False, small_run / "config.json", Report())
    unchecked = shutil.copytree(small_run, tmp_path / "unchecked")
    (unchecked / "history.csv").unlink()
    with pytest.raises(BadInput, match="holds no held-out quality.* Or choose another figure with --only"):
        suite.bench(None, unchecked, ("training",), False, tmp_path / "out", Report())
    assert not (tmp_path / "out").exists()
    with pytest.raises(BadInput, match="Give one"):
        suite.bench(tmp_path, small_run, FIGURES, False, tmp_path / "out", Report())


@pytest.mark.skipif(lock.fcntl is None, reason="this system has no flock(2)")
def test_what_a_killed_bench_left_is_removed_by_the_next(tmp_path, monkeypatch):
    killed, used = tmp_path / ".wegs-bench.wegs-1", []
    killed.mkdir()
    os.utime(killed, (1e9, 1e9))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(suite, "_train", lambda *arguments: used.append(arguments[2]) or pytest.fail("stopped"))
    with pytest.raises(pytest.fail.Exception, match="stopped"):
        suite.bench(None, None, ("training",), False, tmp_path / "bench", Report())
    assert not killed.exists() and used[0].parent.name.startswith(".wegs-bench.wegs-") and not used[0].parent.exists()


def test_a_runs_own_cameras_are_rendered_in_the_neutral_look(small_run, monkeypatch):
    asked = []
    monkeypatch.setattr(suite, "rendering_figure", lambda *given, **named: asked.append((*given, named)))
    monkeypatch.chdir(small_run)
    trained = load_run(Path())
    suite._rendering_of(trained, replace(TINY, cameras=1), Report())
    what, splats, cameras, *_, named = asked[0]
    assert torch.equal(splats.sh, bake(trained, find_look(trained, "neutral")).sh)
    assert (cameras[0].width, cameras[0].height) == (WIDTH, HEIGHT)
    assert named["name"] == suite.OF_RUN and what == small_run.name


def test_curves_of_runs_go_into_the_first_and_leave_a_run_that_can_be_replaced(small_run):
    figures = suite.curves((small_run, small_run), ("full",), True, Report())
    assert [figure.name for figure in figures] == ["training", "refinement"]
    assert {"training.png", "refinement.csv"} <= {path.name for path in (small_run / "curves").iterdir()}
    assert len(suite.curves((small_run,), ("full",), False, Report())) == 1
    assert load_run(small_run).step == 40


def test_a_run_given_twice_is_drawn_once_and_no_figure_of_other_runs_stays(small_run, tmp_path, monkeypatch):
    folder, heard = shutil.copytree(small_run, tmp_path / "small"), Heard()
    (folder / "curves").mkdir(exist_ok=True)
    (folder / "curves" / "refinement.png").write_text("of another run")
    monkeypatch.chdir(tmp_path)
    (training,) = suite.curves((folder, Path("small")), ("full",), False, heard)
    assert list(training.curves()) == ["small"]
    assert {path.stem for path in (folder / "curves").iterdir()} == {"training"}
    assert any("removed refinement.png" in line for line in heard.lines)


def test_a_run_whose_photos_are_gone_is_drawn_by_its_history(small_run, tmp_path):
    folder, heard = shutil.copytree(small_run, tmp_path / "small"), Heard()
    facts = json.loads((folder / "config.json").read_text())
    facts["scene"] |= {"path": str(tmp_path / "gone"), "from_run": "../gone"}
    (folder / "config.json").write_text(json.dumps(facts))
    assert [figure.name for figure in suite.curves((folder,), ("full",), True, heard)] == ["training"]
    assert any("Nothing is drawn of the refinement" in line and "Move it back" in line for line in heard.lines)


def test_runs_of_one_name_are_told_apart_by_their_folders(small_run, tmp_path, monkeypatch):
    folders = [tmp_path / place / "runs" / "plaza" for place in ("here", "there")]
    for folder in folders:
        shutil.copytree(small_run, folder)
    training, refinement = suite.curves(tuple(folders), ("full",), True, Report())
    assert list(training.curves()) == ["here/runs/plaza", "there/runs/plaza"]
    assert list(refinement.curves()) == ["here/runs/plaza, full", "there/runs/plaza, full"]
    monkeypatch.chdir(folders[0])
    assert list(suite.curves((Path("."),), ("full",), False, Report())[0].curves()) == ["plaza"]


def test_without_held_out_photos_the_rest_is_measured(small_run, tmp_path, monkeypatch):
    trained, heard = load_run(small_run), Heard()
    monkeypatch.setattr(suite, "open_run", lambda *_: replace(trained, collection=trained.collection.undivided()))
    figures = suite.bench(None, small_run, ("baking", "training", "refinement"), False, tmp_path, heard)
    assert [figure.name for figure in figures] == ["baking"]
    assert heard.lines[0].startswith("Nothing is drawn of training and refinement: No photo of small is held out.")
    with pytest.raises(BadInput, match="No photo of small is held out.* Or choose another figure with --only"):
        suite.bench(None, small_run, ("training",), False, tmp_path / "other", heard)


def test_without_checks_on_the_way_the_rest_is_measured(small_run, tmp_path):
    folder, heard = shutil.copytree(small_run, tmp_path / "small"), Heard()
    (folder / "history.csv").unlink()
    (tmp_path / "training.csv").write_text("of another run")
    (tmp_path / "refinement.csv").write_text("not asked for")
    figures = suite.bench(None, folder, ("training", "baking", "training"), False, tmp_path, heard, force=True)
    assert [figure.name for figure in figures] == ["baking"]
    assert {path.stem for path in tmp_path.glob("*.csv")} == {"baking", "refinement"}
    assert heard.lines[0].startswith(
        f"Nothing is drawn of training: {folder / 'history.csv'} holds no held-out quality."
    )


def test_where_no_held_out_photo_can_be_read_no_older_refinement_stays(small_run, tmp_path, monkeypatch):
    trained, heard = load_run(small_run), Heard()
    photos = tuple(replace(photo, path=tmp_path / "gone.png") for photo in trained.collection.photos)
    moved = replace(trained, collection=replace(trained.collection, photos=photos))
    monkeypatch.setattr(suite, "open_run", lambda *_: moved)
    (tmp_path / "refinement.csv").write_text("of another run")
    figures = suite.bench(None, small_run, ("training", "refinement"), False, tmp_path, heard, force=True)
    assert [figure.name for figure in figures] == ["training"] and not (tmp_path / "refinement.csv").exists()
    assert any(line.startswith("! Nothing is drawn of the refinement: ") for line in heard.lines)


def test_a_folder_that_cannot_be_made_is_refused_before_the_minutes(tmp_path, monkeypatch):
    """For root, the system may say that a folder can be written in where it cannot, as in /proc."""
    monkeypatch.setattr(suite, "_fixed_rendering", lambda *_: pytest.fail("it was measured first"))
    monkeypatch.setattr(Path, "mkdir", failing(FileNotFoundError(2, "No such file or directory")))
    with pytest.raises(BadInput, match="out could not be made: No such file or directory. Choose another -o"):
        suite.bench(None, None, ("rendering",), False, tmp_path / "out", Report())


def test_a_run_without_looks_has_no_refinement_and_says_so(small_run, tmp_path, monkeypatch):
    heard, trained = Heard(), load_run(small_run)
    trained = replace(trained, settings=trained.settings.changed(appearance="off"))
    monkeypatch.setattr(suite, "open_run", lambda *_: trained)
    with pytest.raises(BadInput, match="nothing to measure"):
        suite.bench(None, small_run, ("refinement",), False, tmp_path, heard)
    assert [figure.name for figure in suite.curves((small_run,), ("full",), True, heard)] == ["training"]
    assert sum("no look to refine" in line for line in heard.lines) == 2


def test_presets_end_in_time_and_differ_in_the_rest():
    for name in PRESETS:
        settings = suite._sized(name, suite.SMALL, 3, True)
        assert settings.steps <= 600 and settings.max_gaussians <= suite.SMALL.gaussians and settings.seed == 3
        assert settings.decided(appearance="full").scale_rate == scale_rate_for(settings.steps)
    assert suite._sized("vanilla", suite.SMALL, 0, True).appearance == "off"
    assert suite._sized("paper", suite.FULL, 0, True).steps == 3000


# --- the built-in scene


def test_what_the_photos_decided_is_kept_with_the_runs_of_a_figure(tmp_path):
    suite._train(
        small_collection(tmp_path), small_settings(steps=1).changed(transients="auto"), tmp_path / "run", Report()
    )
    decisions = json.loads((tmp_path / "run" / "config.json").read_text())["decisions"]
    assert [decision["setting"] for decision in decisions] == ["transients"]


def test_the_built_in_collection_is_the_same_every_time_and_shows_different_lights(tmp_path):
    folders = [tmp_path / name for name in ("a", "b")]
    for folder in folders:
        folder.mkdir()
    first, second = (small_scene.collection(folder) for folder in folders)
    assert np.array_equal(first.points, second.points)
    assert [photo.path.read_bytes() for photo in first.photos] == [photo.path.read_bytes() for photo in second.photos]
    assert len(first.split("test")) == small_scene.PHOTOS // small_scene.HELD_OUT_EVERY
    for photo in first.photos:  # the points are where the cameras look
        pixels, depths = photo.camera.project(first.points)
        inside = (pixels >= 0).all(axis=1) & (pixels <= [small_scene.WIDTH, small_scene.HEIGHT]).all(axis=1)
        assert (depths > 0).all() and inside.mean() > 0.9


def test_a_machine_that_does_not_name_its_processor_is_still_described(monkeypatch):
    monkeypatch.setattr(machine.Path, "read_text", failing(OSError))
    assert machine.cpu_model()
    assert machine._version("no-such-package") == "unknown"
