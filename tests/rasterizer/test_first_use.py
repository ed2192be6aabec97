"""The process in which the kernels are compiled, beside those that find them in Numba's cache."""

import os
import subprocess
import sys

from tests.test_layers import ROOT

# The quaternion of a ball has no gradient but what rounding leaves of it.
DRAW = """
import hashlib, torch
import core.rasterizer
from core.scene.splats import Splats
from tests.small import ring_camera
torch.manual_seed(0)
rows = 20_000
quaternions = torch.tensor([1.0, 0.0, 0.0, 0.0]) + 1e-8 * torch.randn(rows, 4)
scales = torch.randn(rows, 1).expand(rows, 3) * 0.3 - 4
parts = [0.3 * torch.randn(rows, 3), quaternions, scales, torch.randn(rows), torch.randn(rows, 1, 3)]
parts = [part.contiguous().requires_grad_() for part in parts]
(core.rasterizer.create("cpu").render(Splats(*parts), ring_camera(0.3)) ** 2).sum().backward()
print(*(hashlib.sha256(part.grad.numpy()).hexdigest() for part in parts))
"""


def test_gradients_are_the_same_bit_for_bit(tmp_path):
    """Where the parts of a kernel had code of their own, it was called while the kernel was fresh, and rounded
    otherwise than what was kept with the kernel in the cache."""
    command, environment = [sys.executable, "-c", DRAW], os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    compiled, kept = (
        subprocess.run(command, env=environment, cwd=ROOT, check=True, capture_output=True, text=True).stdout
        for _ in range(2)
    )
    assert list(tmp_path.rglob("*.nbc"))
    assert compiled == kept
