"""Baking: errors grow and bytes fall with what is left out; the order is that of the contributions."""

import torch

import core.rasterizer
from core.bench import baking
from core.bench.baking import baking_figure, steps_apart
from core.rasterizer.views import largest_contributions
from core.report import Report
from tests.rasterizer.scenes import camera, cloud


def test_bytes_fall_and_errors_grow_along_each_curve(trained, monkeypatch):
    monkeypatch.setattr(baking, "SHARES", (0.0, 0.5, 0.9))
    made = baking_figure(trained, views=2, report=Report(), budget=0.0)
    curves = made.curves()
    assert list(curves) == ["SH degree 1", "SH degree 0"]
    for points in curves.values():
        sizes = [point.values["megabytes"].median for point in points]
        errors = [point.values["rms_steps"].median for point in points]
        assert sizes[0] > sizes[1] > sizes[2] and errors[0] < errors[1] < errors[2]
    whole, bare = curves["SH degree 1"][0], curves["SH degree 0"][0]
    assert whole.is_default and whole.values["rms_steps"].median == whole.values["max_steps"].median == 0
    assert bare.values["rms_steps"].median > 0
    assert [point for point in made.points if point.is_default] == [whole]


def test_a_contribution_is_the_largest_over_all_views():
    view = camera()
    splats = cloud(view, 20, seed=1)
    away = camera(turned=False)
    rasterizer = core.rasterizer.create("cpu")
    both = largest_contributions(splats, [view, away], rasterizer)
    alone = [rasterizer.contributions(splats, one) for one in (view, away)]
    assert torch.equal(both, torch.maximum(*alone)) and float(both.max()) > 0


def test_errors_are_in_8_bit_steps_of_clamped_pictures():
    truth = [torch.ones(1, 2, 3)]
    found = steps_apart([torch.tensor([[[1.0, 7.0, 1.0], [1.0, 1.0, 1 - 3 / 255]]])], truth)
    assert abs(found["max_steps"].median - 3) < 1e-4  # float32 beside 1: 255 * 6e-8
    assert abs(found["rms_steps"].median - 3 / 6**0.5) < 1e-4
