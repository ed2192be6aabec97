"""The benchmark of the GPU, tried with Triton's interpreter on a few Gaussians:
everything but the times. See test_benchmark."""

import sys
import time
from functools import partial
from types import SimpleNamespace

import pytest
import torch
from click.testing import CliRunner

from core.config import Settings
from samples import benchmark_cuda
from samples.measurements import gpu
from tests.gsplat_stand_in import rasterization

pytest.importorskip("triton", reason="Triton is not installed")

from samples.measurements import on_gpu, peer

SIZES = {"regs_per_multiprocessor": 65_536, "shared_memory_per_multiprocessor": 233_472}
CARD = SimpleNamespace(major=9, minor=0, max_threads_per_multi_processor=2048, **SIZES)
# 24 blocks at once instead of 32.
SMALLER = SimpleNamespace(major=8, minor=9, max_threads_per_multi_processor=1536, **SIZES)


class Moment:
    """A moment of the host's clock, with the interface of torch.cuda.Event."""

    def __init__(self):
        self.time = time.perf_counter()

    def elapsed_time(self, other: "Moment") -> float:
        return 1e3 * (other.time - self.time)


HERE = gpu.Place(torch.device("cpu"), Moment, lambda: None)
interpreted = pytest.mark.skipif(
    torch.cuda.is_available(), reason="tried with Triton's interpreter; with a GPU, run the script itself"
)


@pytest.fixture
def small(monkeypatch):
    """Few Gaussians, few pixels, few repeats; a gsplat that is none."""
    sizes = {"GAUSSIANS": 25, "SIZE_PX": (16, 16), "STEP_SIZES": (10,), "STEP_GAUSSIANS": 20, "PAPER_GAUSSIANS": 10}
    for name, value in {**sizes, "PAPER_STEPS_TIMED": 1, "WARM_UP": 1, "TIMES": 1, "STEPS": 1}.items():
        monkeypatch.setattr(on_gpu, name, value)
    settings = {"sky_gaussians": 12, "encoder_side_px": 16}
    monkeypatch.setattr(on_gpu, "Settings", partial(Settings, **settings))
    monkeypatch.setattr(on_gpu, "EVERYTHING", on_gpu.EVERYTHING.changed(**settings))
    monkeypatch.setattr("samples.measurements.steps.STEP_GAUSSIANS", 20)
    monkeypatch.setattr("samples.measurements.scenes.STEP_GAUSSIANS", 20)
    monkeypatch.setattr(on_gpu, "trainer_of", partial(on_gpu.trainer_of, size_px=(16, 12)))
    monkeypatch.setattr("samples.measurements.scenes.STEP_PHOTOS", 2)
    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=rasterization))


@interpreted
@pytest.mark.parametrize("name", benchmark_cuda.NAMES)
def test_everything_is_measured(small, name):
    lines = {what: found for what, _, found in on_gpu.MEASUREMENTS[name](HERE)}
    assert lines and all(found for found in lines.values())
    if name == "picture":
        # Ours is float32 with float32's camera on either way; through exp, log and back.
        assert float(lines["picture against gsplat's, constants equal"].split()[-3]) < 1e-4
        assert "rasterizer backward" in str(lines)


@interpreted
def test_a_missing_gsplat_is_reported(small, monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)
    assert peer.gsplat() is None
    assert on_gpu.MISSING in str(list(on_gpu.measure_picture(HERE)))


def test_names_are_those_of_the_measurements():
    assert benchmark_cuda.NAMES == tuple(on_gpu.MEASUREMENTS)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_one_line_says_so():
    result = CliRunner().invoke(benchmark_cuda.main, [])
    assert result.exit_code == 1 and result.output.count("\n") == 1 and "no NVIDIA GPU" in result.output


def test_launches_waits_and_kernels_are_counted_separately():
    def event(key, count, on_gpu=0.0, on_cpu=1.0, named=False):
        return SimpleNamespace(
            key=key, count=count, device_time_total=on_gpu, cpu_time_total=on_cpu, is_user_annotation=named
        )

    events = [
        event("cudaLaunchKernel", 7),
        event("cuLaunchKernelEx", 2),
        event("cudaStreamSynchronize", 1),
        event("aten::mul", 3, 5.0),
    ]
    events += [event("cudaDeviceSynchronize", 1), event("Optimizer.step#Adam.step", 1, 900.0, 0.0, named=True)]
    found = gpu.seen([*events, event("blend_forward", 1, 2000.0, 0.0)])
    assert found == gpu.Seen(launches=9, waits=1, kernels={"blend_forward": 0.002})


@pytest.mark.parametrize(
    "registers, shared, warps, expected",
    [
        (32, 0, 4, 1.0),
        (64, 0, 4, 0.5),
        (65, 0, 2, 0.4375),
        (136, 0, 1, 15 / 64),
        (32, 100_000, 4, 8 / 64),
        (16, 0, 1, 0.5),
    ],
)
def test_occupancy_is_nvidias(registers, shared, warps, expected):
    """Bound by registers, by shared memory, and by the number of blocks."""
    assert gpu.occupancy(registers, shared, warps, CARD) == pytest.approx(expected)
    assert gpu.occupancy(16, 0, 1, SMALLER) == 0.5


def test_compiled_kernels_are_found_in_their_modules():
    binary = SimpleNamespace(n_regs=64, n_spills=2, metadata=SimpleNamespace(shared=0, num_warps=4))
    kernel = SimpleNamespace(device_caches={0: ({"key": binary}, None)})
    assert gpu.compiled([SimpleNamespace(draw=kernel, other=3)], CARD) == [("draw", 64, 8, 0.5)]
