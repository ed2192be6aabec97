"""The CUDA kernels compile for every GPU generation that torch supports, without a GPU, and fit into its registers."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("triton", reason="Triton is not installed")

ROOT = Path(__file__).parents[2]
# A thread's share of a multiprocessor's 65,536 registers decides how many programs run beside each other and hide each
# other's waiting: at 64 registers 32 warps do, at 128 half as many. The most that Triton 3.6 and 3.7.1 take on any of
# the six, rounded up. So does 3.9, but for blend_backward of divided tiles on sm_90: 139.
MOST_REGISTERS = {
    "find_visible": 80,
    "project": 88,
    "list_tiles": 48,
    "blend_forward": 96,
    "blend_backward": 128,
    "add_up": 64,
    "take_rows": 48,
    "update": 32,
    "add_view": 24,
    "encode_positions": 32,
    "blur_products_down": 64,
    "blur_down": 40,
    "compare": 80,
    "combine": 80,
    "weigh_residual": 40,
    "project_backward": 112,
}
MOST_SPILLED = 24  # bytes: ptxas gives some registers up to come below a step of occupancy (Triton 3.9)
# The oldest, and that of the machines that the kernels ran on; the others differ little and are for -m slow.
USUAL = (75, 90)
GENERATIONS = (75, 80, 86, 89, 90, 100)


@pytest.mark.parametrize(
    "capability",
    [number if number in USUAL else pytest.param(number, marks=pytest.mark.slow) for number in GENERATIONS],
)
def test_kernels_compile_and_spill_nothing(capability, tmp_path):
    command = [sys.executable, "-m", "tests.rasterizer.compiled_kernels", str(capability)]
    environment = {**os.environ, "TRITON_CACHE_DIR": str(tmp_path)}
    environment.pop("TRITON_INTERPRET", None)
    result = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)[f"sm_{capability}"]
    assert {kernel.split()[0] for kernel in found} == MOST_REGISTERS.keys()
    for kernel, taken in found.items():  # variants, behind the name, keep to its bound
        assert taken["registers"] <= MOST_REGISTERS[kernel.split()[0]] and taken["spilled"] <= MOST_SPILLED, (
            kernel,
            taken,
        )
