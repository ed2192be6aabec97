"""Levers: at the contract's values they change nothing; beyond them they trade quality for time. How that is timed."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

import core.rasterizer
from core.bench import rendering, small_scene, stopwatch
from core.bench.levers import UNTHRESHOLDED, Levers, draw
from core.bench.rendering import DEFINITION, Way, choices, rendering_figure
from core.rasterizer.contract import ALPHA_MIN
from core.report import Report
from tests.rasterizer.scenes import SCENES, camera, cloud

# The same sums in another order: some hundred terms below 1 in float64, each rounded to 1e-16.
REORDERED = 1e-13


def error(first, second) -> float:
    return float((first.double() - second).abs().max())


@pytest.mark.parametrize("name", ["random_degree_3", "needles", "behind_camera"])
@pytest.mark.parametrize("tile", [5, 16, 1000])
def test_the_contracts_levers_draw_the_definition(name, tile):
    scene = SCENES[name]()
    splats = scene.splats.map(torch.Tensor.double)
    exact = core.rasterizer.create(DEFINITION).render(splats, scene.camera)
    assert error(draw(scene.splats, scene.camera, Levers(tile_px=tile)), exact) < REORDERED


def test_every_lever_moves_the_picture_and_the_coarser_the_more():
    view = camera()
    splats = cloud(view, 150, seed=3, degree=2, sizes_px=(2.0, 8.0), opacities=(0.3, 0.95))
    exact = draw(splats, view, Levers())
    for coarser in (
        [Levers(alpha_min=4 * ALPHA_MIN), Levers(alpha_min=16 * ALPHA_MIN)],
        [Levers(stop_transmittance=1e-3), Levers(stop_transmittance=1e-1)],
        [Levers(sh_degree=1), Levers(sh_degree=0)],
    ):
        less, more = (float((draw(splats, view, levers) - exact).square().mean()) for levers in coarser)
        assert 0 < less < more
    # The contract's thresholds are nearer to none at all than coarser ones are.
    none = draw(splats, view, UNTHRESHOLDED)
    assert error(exact, none) < error(draw(splats, view, Levers(alpha_min=4 * ALPHA_MIN)), none)


def test_the_definition_has_a_curve_for_every_lever_and_auto_is_the_default():
    splats, cameras = small_scene.rendering_scene()
    found = list(choices(splats, cameras))
    levers = {f"{DEFINITION}: {lever}" for lever in ("precision", "tile", "alpha threshold", "early stop", "SH degree")}
    assert {choice.curve for choice in found} == levers | {"cpu: SH degree"}
    for curve in levers:  # on which nothing is drawn twice, and the contract's levers are among them
        ways = [choice.way for choice in found if choice.curve == curve]
        assert len(set(ways)) == len(ways) and Way(None, Levers()) in ways
    (default,) = (choice for choice in found if choice.is_default)
    assert (default.curve, default.label, default.way.backend) == ("cpu: SH degree", "degree 3", "cpu")


def test_a_way_on_several_curves_is_measured_once(monkeypatch):
    monkeypatch.setattr(rendering, "TILES_PX", (16,))
    monkeypatch.setattr(rendering, "ALPHAS", {"1/255": 1.0})
    view = camera()
    monkeypatch.setattr(rendering, "timed", lambda work, _: (work(), stopwatch.Spread.exactly(0.5)))
    made = rendering_figure("a cloud", cloud(view, 30, seed=1, degree=1), [view, view], Report(), seed=5, budget=0.0)
    of = {(point.curve, point.label): point.values for point in made.points}
    assert of["reference: alpha threshold", "alpha 1/255"] is of["reference: SH degree", "degree 1"]
    assert all(values["milliseconds"].median == 250 for values in of.values())  # a picture
    assert of["reference: precision", "float64"]["max_error"].median == 0
    assert of["reference: tile", "no tiles"]["max_error"].median < REORDERED
    assert 0 < of["cpu: SH degree", "degree 1"]["max_error"].median < 1e-4
    assert made.made_on["seed"] == "5" and made.title.startswith("Rendering a cloud: 30 Gaussians of degree 1, ")


def test_the_definition_is_timed_whole_only_where_that_takes_seconds():
    splats, cameras = small_scene.rendering_scene()
    large = [replace(view, width=4000, height=3000) for view in cameras]
    assert any(choice.label == "no tiles" for choice in choices(splats, cameras))
    assert not any(choice.label == "no tiles" for choice in choices(splats, large))


@pytest.mark.parametrize(
    "budget, seconds, counted",
    [
        (6, (5, 1, 2, 3), (1, 2, 3)),  # the first warms up
        (6.5, (5, 1, 2, 3, 9), (1, 2, 3, 9)),
        (4, (5, 1, 2), (5, 1, 2)),  # too long for a call that does not count
        (1e9, [1] * (stopwatch.MOST + 1), [1] * stopwatch.MOST),
    ],
)
def test_as_many_repeats_are_timed_as_fit_into_the_budget(monkeypatch, budget, seconds, counted):
    now, left = [0.0], list(seconds)
    monkeypatch.setattr(stopwatch, "time", SimpleNamespace(perf_counter=lambda: now[0]))

    def work() -> int:
        now[0] += left.pop(0)
        return len(left)

    assert stopwatch.timed(work, budget) == (0, stopwatch.Spread.of(counted)) and not left
