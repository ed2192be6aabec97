"""Baking: errors grow and bytes fall with what is left out; the order is that of the contributions."""

import pytest
import torch

import core.rasterizer
from core.bench import baking
from core.bench.baking import baking_figure
from core.bench.differences import differences
from core.data.collection import spread_over
from core.looks.find_look import find_look
from core.looks.pruning import pruner_of
from core.looks.trained import bake, load_run
from core.rasterizer.importance import largest_contributions
from core.report import Report
from tests.rasterizer.scenes import camera, cloud
from tests.small import finished, small_collection, small_settings


def test_bytes_fall_and_errors_grow_along_each_curve(trained, monkeypatch):
    monkeypatch.setattr(baking, "SHARES", (0.0, 0.5, 0.9))
    made = baking_figure(trained, views=2, report=Report(), budget=0.0)
    curves = made.curves()
    assert list(curves) == ["wegs bake", "SH degree 1", "SH degree 0"]
    (as_it_bakes,) = curves.pop("wegs bake")
    for points in curves.values():
        sizes = [point.values["megabytes"].median for point in points]
        grown = [point.values["rms_steps"].median for point in points]
        assert sizes[0] > sizes[1] > sizes[2] and grown[0] < grown[1] < grown[2]
    whole, bare = curves["SH degree 1"][0], curves["SH degree 0"][0]
    assert (
        whole.label == "everything (--prune off)"
        and whole.values["rms_steps"].median == whole.values["max_steps"].median == 0
    )
    assert bare.values["rms_steps"].median > 0
    assert whole.values["megabytes"].median == pytest.approx(248e-6 * len(trained.splats), abs=0.003)  # and its header
    neutral = find_look(trained, "neutral")
    cameras = [trained.camera(photo) for photo in spread_over(trained.collection.split("train"), 2)]
    look, without = (
        [trained.rasterizer.render(splats, camera, trained.background).clamp(0, 1) for camera in cameras]
        for splats in (bake(trained, neutral), bake(trained, neutral).up_to_degree(0))
    )
    apart = differences(without, look)
    assert bare.values["max_steps"].median == pytest.approx(255 * apart["max_error"].median)
    assert [point for point in made.points if point.is_default] == [as_it_bakes]
    left = pruner_of(trained, Report())(bake(trained, neutral))
    assert as_it_bakes.values["max_steps"].median <= 0.5
    assert (as_it_bakes.values["megabytes"].median < whole.values["megabytes"].median) == (left.gaussians > 0)


def test_something_is_always_left(tmp_path, monkeypatch):
    run = load_run(finished(small_collection(tmp_path), small_settings(sky="none", steps=1), tmp_path / "run").folder)
    monkeypatch.setattr(baking, "SHARES", (0.0, 0.5, 1.0))
    made = baking_figure(run, views=1, report=Report(), budget=0.0)
    assert [point.label for point in made.curves()["SH degree 0"]] == ["0% pruned", "50% pruned"]


def test_a_contribution_is_the_largest_over_all_views():
    view = camera()
    splats = cloud(view, 20, seed=1)
    away = camera(turned=False)
    rasterizer = core.rasterizer.create("cpu")
    both = largest_contributions(splats, [view, away], rasterizer)
    alone = [rasterizer.contributions(splats, one) for one in (view, away)]
    assert torch.equal(both, torch.maximum(*alone)) and float(both.max()) > 0


def test_errors_are_the_largest_and_the_mean_of_all_pictures():
    truth = [torch.ones(1, 2, 3), torch.zeros(1, 1, 3)]
    found = differences([torch.tensor([[[1.0, 1.0, 1.0], [1.0, 1.0, 0.25]]]), truth[1]], truth)
    assert found["max_error"].median == 0.75 and found["rms_error"].median == 0.25  # sqrt(0.75^2 / 9)
