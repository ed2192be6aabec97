"""Levers: at the contract's values they change nothing, beyond them they trade as they should."""

import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

import core.rasterizer
from core.bench import rendering, small_scene
from core.bench.levers import UNTHRESHOLDED, Levers, draw, recompiled
from core.bench.rendering import DEFINITION, choices, rendering_figure
from core.rasterizer.contract import ALPHA_MIN, STOP_TRANSMITTANCE
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


def test_a_backend_compiled_anew_draws_with_other_thresholds_and_leaves_this_process_alone():
    view = camera()
    splats = cloud(view, 150, seed=3, sizes_px=(2.0, 8.0))
    before = core.rasterizer.create("cpu").render(splats, view)
    alpha_min, stop = 8 * ALPHA_MIN, 1e-2
    (picture,), seconds = recompiled("cpu", alpha_min, stop, splats, [view], budget=0.0)
    wanted = draw(splats, view, Levers(alpha_min=alpha_min, stop_transmittance=stop))
    # float32 against float64; a pixel on the verge of a threshold may differ by the threshold, most may not.
    differences = np.abs(picture - wanted.numpy()).max(axis=2)
    assert np.quantile(differences, 0.99) < 1e-5 < float((before - wanted).abs().max())
    assert 0 < seconds.low <= seconds.median
    assert torch.equal(core.rasterizer.create("cpu").render(splats, view), before)


def test_the_process_of_its_own_ends_where_wegs_is_killed():
    script = """
import os, signal
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from core.bench import levers
process = ProcessPoolExecutor(1, get_context("spawn"))
process.submit(levers._set_constants, "cache", 0.1, 0.1, 1).result()
os.kill(os.getpid(), signal.SIGKILL)
"""
    # Both hold standard output: what reads it to its end waits for the later of them.
    killed = subprocess.run([sys.executable, "-c", script], check=False, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=60)
    assert killed.returncode == -signal.SIGKILL


def test_every_backend_and_every_lever_has_a_curve_and_auto_is_the_default_on_each_of_its_own():
    splats, cameras = small_scene.rendering_scene()
    found = list(choices(splats, cameras, full=True))
    curves = {choice.curve for choice in found}
    for backend in core.rasterizer.BACKENDS.keys() - core.rasterizer.ON_GPU:
        assert {f"{backend}: {lever}" for lever in ("alpha threshold", "early stop", "SH degree")} <= curves
    assert {f"{DEFINITION}: precision", f"{DEFINITION}: tile"} <= curves
    assert {c.curve for c in found if c.is_default} == {c for c in curves if c.startswith("cpu")}
    for choice in found:
        if choice.is_default:
            thresholds = choice.way.levers.alpha_min, choice.way.levers.stop_transmittance
            assert thresholds == (ALPHA_MIN, STOP_TRANSMITTANCE) and choice.way.levers.sh_degree == splats.degree


def test_a_way_on_several_curves_is_measured_once(monkeypatch):
    monkeypatch.setattr(rendering, "TILES_PX", (16,))
    monkeypatch.setattr(rendering, "ALPHAS", {"1/255": 1.0})
    monkeypatch.setattr(rendering, "STOPS", (STOP_TRANSMITTANCE,))
    monkeypatch.setattr(rendering, "MOST_PAIRS", 0)
    view = camera()
    made = rendering_figure(cloud(view, 30, seed=1, degree=1), [view], "r", "R", 5, Report(), 0.0, False)
    of = {(point.curve, point.label): point.values for point in made.points}
    assert of["cpu: alpha threshold", "alpha 1/255"] is of["cpu: SH degree", "degree 1"]
    assert of["reference: precision", "float64"]["max_error"].median == 0
    assert 0 < of["cpu: SH degree", "degree 1"]["max_error"].median < 1e-4
    assert made.made_on["seed"] == "5"


def test_the_definition_is_timed_whole_only_where_that_takes_seconds():
    splats, cameras = small_scene.rendering_scene()
    large = [replace(view, width=4000, height=3000) for view in cameras]
    assert any(choice.label == "no tiles" for choice in choices(splats, cameras, full=False))
    assert not any(choice.label == "no tiles" for choice in choices(splats, large, full=False))
