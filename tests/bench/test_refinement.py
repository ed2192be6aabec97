"""Refinement curves: the protocols' own regions and figures, step by step."""

from dataclasses import replace

import pytest

from core.appearance.refinement import LATER_STEPS, STEPS
from core.bench import refinement
from core.bench.refinement import MEASURED, refinement_figure
from core.data.collection import spread_over
from core.errors import BadInput
from core.evaluation import PROTOCOLS
from core.evaluation.protocols import measure
from core.looks.held_out_views import held_out_view, over_views
from core.report import Report
from tests.heard import Heard
from tests.small import damage


def test_the_course_begins_and_ends_with_the_figures_of_the_evaluation(trained):
    made = refinement_figure({"run": trained}, tuple(PROTOCOLS), 1, Report())
    assert made.title == "Refinement: run at step 40"
    photo = spread_over(trained.collection.split("test"), 1)[0]
    for protocol, points in made.curves().items():
        result, _ = measure(trained, held_out_view(trained, photo), protocol)
        scores = result.scores["photo"]
        assert points[0].values[f"psnr_{protocol}"].median == scores["zero_shot"].psnr
        assert points[-1].values[f"psnr_{protocol}"].median == scores["refined"].psnr
        assert points[0].values[f"gain_{protocol}"].median == 0
        assert [point.values["steps"].median for point in points] == list(MEASURED)
        assert [point.is_default for point in points] == [steps == STEPS + LATER_STEPS for steps in MEASURED]
        for panel in made.panels:  # figures of one protocol never stand beside those of the other
            assert (points[0] in made.shown(panel)) == panel.y.endswith(protocol)
        seconds = [point.values["seconds"].median for point in points]
        assert seconds == sorted(seconds) and seconds[0] > 0


def test_the_seeds_of_all_runs_are_stated(trained):
    other = replace(trained, settings=trained.settings.changed(seed=trained.settings.seed + 3))
    made = refinement_figure({"a": other, "b": trained}, ("full",), 1, Report())
    assert made.made_on["seed"] == f"{trained.settings.seed}, {other.settings.seed}"


def test_a_damaged_photo_is_named_and_the_others_are_measured(trained):
    heard, photos = Heard(), list(trained.collection.photos)
    tests = [index for index, photo in enumerate(photos) if photo.split == "test"]
    whole = photos[tests[0]].path.read_bytes()
    photos[tests[0]] = damage(photos[tests[0]])
    broken = replace(trained, collection=replace(trained.collection, photos=tuple(photos)))
    made = refinement_figure({"run": broken}, ("full",), 10, heard)
    assert len(made.points) == len(MEASURED)
    assert any(photos[tests[0]].name in line for line in heard.lines)
    assert photos[tests[0]].path.with_suffix(".png").read_bytes() == whole


def test_the_reason_is_given_if_no_photo_can_be_measured(trained):
    photos = tuple(replace(photo, path=photo.path.with_name("gone.png")) for photo in trained.collection.photos)
    moved = replace(trained, collection=replace(trained.collection, photos=photos))
    heard = Heard()
    with pytest.raises(BadInput, match="gone.png cannot be opened"):
        refinement_figure({"run": moved}, ("full",), 3, heard)


def test_a_protocol_that_cannot_be_measured_leaves_the_other(trained, monkeypatch):
    def measure_all(run, photos, measured, what, *rest):
        if "half" in what:
            raise BadInput("a.png is 1 px wide and has no halves.")
        yield from over_views(run, photos, measured, what, *rest)

    monkeypatch.setattr(refinement, "over_views", measure_all)
    heard = Heard()
    made = refinement_figure({"run": trained}, ("half", "full"), 1, heard)
    assert len(made.points) == len(MEASURED) and {panel.y for panel in made.panels} == {"gain_full"}
    assert "! run is not measured by half: a.png is 1 px wide and has no halves." in heard.lines


def test_a_run_without_held_out_photos_is_refused(trained):
    train = trained.collection.split("train")
    with pytest.raises(BadInput, match="nothing to draw"):
        refinement_figure(
            {"run": replace(trained, collection=replace(trained.collection, photos=train))}, ("full",), 3, Report()
        )
