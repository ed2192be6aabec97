"""The benchmark measures what it says, tried at a hundredth of its sizes. How fast anything is, is not tested."""

import json
import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from click.testing import CliRunner

from core.appearance.transfer_kernel import _BlockwiseMLP
from core.config import Settings
from core.rasterizer.cpu.backend import _Render
from core.training.photometric_kernel import _Photometric
from core.training.trainer import Trainer
from samples import benchmark

SCALE = 0.01
KERNELS = {_BlockwiseMLP: "MLP", _Render: "drawing", _Photometric: "SSIM"}
FORWARD = ["visible, gather", "visible, gather", "encoder forward", "SH transfer forward", "rasterizer forward"]
FORWARD += ["picture loss", "mask, regularisers", "mask, regularisers"]
# In capitals: a kernel's backward pass, followed by the lap that it has to count for. The gauge has an MLP of its own.
PLAIN = ["mask, regularisers", "SSIM BACK", "picture loss", "DRAWING BACK", "rasterizer backward"]
FULL = ["MLP BACK", *PLAIN, "MLP BACK"]
END = ["SH transfer backward", "encoder backward", "Adam"]


@pytest.mark.parametrize("appearance, transients, backward", [("full", "on", FULL), ("off", "off", PLAIN)])
def test_laps_hold_what_they_are_named_after(monkeypatch, appearance, transients, backward):
    """The hooks rely on the order in which autograd walks back: with another one, times would go to the wrong parts."""
    settings = Settings(resolution=1, max_gaussians=600, appearance=appearance, transients=transients, sh_degree=1)
    trainer = Trainer(benchmark.plaza(SCALE), settings, Path())
    trainer.done = settings.steps // 2
    stopwatch, happened = benchmark.Stopwatch(), []
    stopwatch.lap = happened.append
    benchmark.watch_step(trainer, stopwatch)
    for kernel, name in KERNELS.items():

        def noted(ctx, *gradients, original=kernel.backward, name=name):
            happened.append(f"{name} back".upper())
            return original(ctx, *gradients)

        monkeypatch.setattr(kernel, "backward", staticmethod(noted))
    trainer.step()
    assert [what for what in happened if what != "everything else"] == FORWARD + backward + END


def test_everything_is_measured_and_written(tmp_path, monkeypatch):
    monkeypatch.setattr(benchmark, "ProcessPoolExecutor", lambda workers, context: ThreadPoolExecutor(workers))
    monkeypatch.setattr(benchmark, "RENDERS", 2)
    file = tmp_path / "figures.json"
    result = CliRunner().invoke(benchmark.main, ["--scale", str(SCALE), "--json", str(file)], catch_exceptions=False)
    assert result.exit_code == 0
    measurements = json.loads(file.read_text())["measurements"]
    assert list(measurements) == list(benchmark.MEASUREMENTS)
    for name, measured in measurements.items():
        assert f"{name}: peak memory" in result.output
        assert measured["peak_memory_mb"] > 50  # torch alone takes more
        parts = measured["parts"]
        whole = parts.pop("whole")
        products = parts.pop("matrix products alone", whole)
        for kind in (0, 1):  # CPU, wall
            assert 0 < whole["low"][kind] <= whole["median"][kind] <= whole["high"][kind]
            assert 0 < products["median"][kind]
            # The whole is summed from the same laps: equal but for rounding.
            assert math.isclose(sum(part["mean"][kind] for part in parts.values()), whole["mean"][kind], rel_tol=1e-9)
    assert {"encoder backward", "SH transfer backward", "rasterizer backward"} < set(measurements["step"]["parts"])
    for name in ("step", "plain-step", "rasterizer"):
        facts = measurements[name]["facts"]
        # A view that saw next to nothing would be fast for the wrong reason.
        assert facts["visible"] > 0.3 * facts["gaussians"]
