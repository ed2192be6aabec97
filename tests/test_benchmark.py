"""The benchmark measures what it says, tried at a hundredth of its sizes. How fast anything is, is not tested."""

import json
import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import torch
from click.testing import CliRunner

from core import rasterizer
from core.appearance.transfer_mlp import _ThroughHidden
from core.config import Settings
from core.rasterizer.cpu.backend import _Render
from core.training.losses.photometric_cpu import _Photometric
from core.training.trainer import Trainer
from samples import benchmark, benchmark_cuda
from samples.measurements import drawing, first_use, steps, threads
from samples.measurements.scenes import STEP_SIZE_PX, plaza
from samples.measurements.stopwatch import Stopwatch

SCALE = benchmark.SMALL
KERNELS = {_ThroughHidden: "MLP", _Render: "drawing", _Photometric: "SSIM"}
FORWARD = ["encoder forward", "SH transfer forward", "rasterizer forward", "picture loss"]
# In capitals: a kernel's backward pass, followed by the lap that it has to count for. The gauge has an MLP of its own.
BACK = [*["mask, regularisers"] * 2, "SSIM BACK", "picture loss", "DRAWING BACK", "rasterizer backward"]
BEGIN = ["rasterizer forward", "gather", *FORWARD, *["mask, regularisers"] * 3]
PLAIN = [*BEGIN, *BACK]
FULL = [*BEGIN, "MLP BACK", *BACK, "MLP BACK"]
END = ["SH transfer backward", "encoder backward", "Adam", "Adam", "Adam"]


@pytest.mark.parametrize("appearance, transients, expected", [("full", "on", FULL), ("off", "off", PLAIN)])
def test_each_lap_times_the_part_it_is_named_after(monkeypatch, appearance, transients, expected):
    """The hooks rely on the order in which autograd walks back: with another one, times would go to the wrong parts."""
    torch.set_num_threads(1)
    settings = Settings(
        resolution=1, max_gaussians=600, appearance=appearance, transients=transients, sh_degree=1, device="cpu"
    )
    trainer = Trainer(plaza(SCALE, STEP_SIZE_PX), settings, Path())
    trainer.state.done = round(steps.PROGRESS * trainer.settings.steps)
    stopwatch, happened = Stopwatch(), []
    stopwatch.lap = happened.append
    steps.watch_step(trainer, stopwatch)
    for kernel, name in KERNELS.items():

        def noted(ctx, *gradients, original=kernel.backward, name=name):
            happened.append(f"{name} back".upper())
            return original(ctx, *gradients)

        monkeypatch.setattr(kernel, "backward", staticmethod(noted))
    trainer.step()
    assert [what for what in happened if what != "everything else"] == expected + (
        END if trainer.optimizer.learners else ["SH transfer backward", "Adam"]
    )


@pytest.mark.parametrize("script", [benchmark, benchmark_cuda])
def test_a_file_that_cannot_be_written_is_refused_before_anything_is_measured(tmp_path, monkeypatch, script):
    monkeypatch.setattr(benchmark, "ProcessPoolExecutor", None)
    result = CliRunner().invoke(script.main, ["--json", str(tmp_path / "none" / "figures.json")])
    assert result.exit_code == 1 and f"There is no folder {tmp_path / 'none'}" in result.output


def test_everything_is_measured_and_written(tmp_path, monkeypatch):
    """All but the first use, which compiles every kernel."""
    monkeypatch.setattr(benchmark, "ProcessPoolExecutor", lambda workers, context: ThreadPoolExecutor(workers))
    for module, name in ((drawing, "RENDERS"), (drawing, "GROWTH_RENDERS"), (drawing, "TILES_MEASURED")):
        monkeypatch.setattr(module, name, 2)
    file = tmp_path / "figures.json"
    names = [name for name in benchmark.MEASUREMENTS if name != "first-use"]
    result = CliRunner().invoke(benchmark.main, [*names, "--small", "--json", str(file)], catch_exceptions=False)
    assert result.exit_code == 0
    measurements = json.loads(file.read_text())["measurements"]
    assert list(measurements) == names
    for name, measured in measurements.items():
        assert f"{name}: peak memory" in result.output
        assert measured["peak_memory_mb"] > 50  # torch alone takes more
        for part in measured["parts"].values():
            for kind in (0, 1):  # CPU, wall
                assert 0 <= part["low"][kind] <= part["median"][kind] <= part["high"][kind]
    assert {"encoder backward", "SH transfer backward", "rasterizer backward"} < set(measurements["step"]["parts"])
    for name in ("step", "plain-step", "rasterizer", "bake"):
        parts = measurements[name]["parts"]
        whole = parts.pop("whole")
        for kind in (0, 1):
            # The whole is summed from the same laps: equal but for rounding.
            assert math.isclose(sum(part["mean"][kind] for part in parts.values()), whole["mean"][kind], rel_tol=1e-9)
    for name in ("step", "plain-step", "rasterizer"):
        facts = measurements[name]["facts"]
        # A view that saw next to nothing would be fast for the wrong reason.
        assert facts["visible"] > 0.3 * facts["gaussians"]
    # A line of the last table for each, with its figure.
    lines = [line for line in result.output.splitlines() if line.startswith("| ")]
    assert len(lines) == 1 + len(names)
    # Plain torch drew the same picture: both are float32, and a pixel is a sum of a few hundred terms at most.
    assert float(measurements["plain-torch"]["facts"]["picture_error"]) < 1e-4
    assert measurements["plain-torch"]["facts"]["times"] > 1
    for name, column in (("gaussians", 0), ("pixels", 2)):
        rows = measurements[name]["series"]["rows"]
        sizes = [row[column] for row in rows]
        assert sizes == sorted(set(sizes)) and len(sizes) == 5


def test_tiles_are_parts_of_the_picture():
    """Together they are the picture, so that what plain torch took for some stands for all."""
    scene, camera = drawing.garden_of(SCALE)
    backend = rasterizer.create("cpu")
    whole = backend.render(scene, camera)
    tiles = [backend.render(scene, drawing.tile_of(camera, 3, 2, tile)) for tile in range(6)]
    pieced = torch.cat([torch.cat(tiles[:3], dim=1), torch.cat(tiles[3:], dim=1)])
    assert pieced.shape == whole.shape
    # Beside its picture a Gaussian's Jacobian is held at the margin, which is nearer for a tile: a few pixels at the
    # rim differ.
    assert ((pieced - whole).abs() < 1e-3).float().mean() > 0.95


def test_one_and_two_threads_are_measured_in_turn_and_the_setting_is_restored():
    seen = []
    before = torch.get_num_threads()
    figures = threads.in_turns(lambda: seen.append(torch.get_num_threads()), 3)
    assert seen == [1, 1, 1, 2, 2, 2] * 4 and torch.get_num_threads() == before
    assert set(figures) == set(threads.WAYS)


def test_first_use_is_split_into_parts(monkeypatch):
    """With two starts made up: compiling is what the first took longer."""
    parts = "Python and torch", "wegs", "photos", "first step", "second step"
    starts = [dict(zip(parts, (1.0, 0.5, 1.0, 12.0, 0.1))), dict(zip(parts, (1.0, 0.5, 1.0, 0.6, 0.1)))]
    monkeypatch.setattr(first_use, "start", lambda cache: starts.pop(0))
    measured = first_use.measure_first_use(1.0)
    assert measured["facts"] == {"compiling_s": 11.4, "kernels_from_cache_s": 0.5}
    assert measured["series"]["rows"][-1] == ["whole", 14.6, 3.2]


def test_a_fresh_process_reaches_its_first_step():
    laps = first_use.start()
    assert list(laps) == ["Python and torch", "wegs", "photos", "first step", "second step"]
    assert all(seconds > 0 for seconds in laps.values())
