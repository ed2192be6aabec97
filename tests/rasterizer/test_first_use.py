"""The process in which the kernels are compiled, beside those that find them in Numba's cache."""

import pytest

from tests.programs import run_python

# In float32, as they are used, gradients hardly show how the kernel rounds, which computes in float64.
DRAW = """
import hashlib, sys
import numpy as np, torch
from numba.core import event
from core.rasterizer.contract import BLACK
from core.rasterizer.cpu import backend
from core.rasterizer.cpu.project_backward import project_backward
from core.rasterizer.cpu.view import View
from core.scene.splats import Splats
from tests.small import ring_camera
torch.manual_seed(0)
rows = 20_000
centres, scales = 0.3 * torch.randn(rows, 3), 0.3 * torch.randn(rows, 3) - 4
arrays = backend.arrays_of(Splats(centres, torch.randn(rows, 4), scales, torch.randn(rows), torch.randn(rows, 1, 3)))
camera, gradients = ring_camera(0.3), [np.empty(array.shape) for array in arrays]
view = View.of(camera)
with event.install_recorder("numba:compile") as compiled:
    lists = backend.coloured_lists(arrays, backend.NOTHING, camera)
    image = backend.draw(lists, camera, BLACK)
    slots = lists.footprints, lists.slot_starts, lists.drawn_chunks, backend.gradients_of_slots(lists, image, image)
    seen = view.rotation, view.centre, view.lens, view.limits
    project_backward(0, rows, *arrays, *seen, *slots, *gradients, backend.NOTHING)
print(*(hashlib.sha256(gradient).hexdigest() for gradient in gradients))
print(*{each.data["dispatcher"].py_func.__module__ for _, each in compiled.buffer}, file=sys.stderr)
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two processes that draw; the second finds what the first has compiled. They print a digest of each gradient,
    and as errors the modules of all functions that were compiled."""
    folder = tmp_path_factory.mktemp("cache")
    runs = [run_python(DRAW, NUMBA_CACHE_DIR=str(folder)) for _ in range(2)]
    assert list(folder.rglob("*.nbc"))
    return runs


def test_gradients_are_the_same_bit_for_bit(runs):
    """Where the parts of a kernel had code of their own, it was called while the kernel was fresh, and rounded
    otherwise than what was kept with the kernel in the cache."""
    compiled, kept = runs
    assert "core.rasterizer.cpu.project" in compiled.stderr and "core" not in kept.stderr
    assert compiled.stdout == kept.stdout


def test_no_text_is_compiled(runs):
    """Numba's text functions take seconds: an array assigned to a slice brings them in, for what it says of shapes."""
    compiled, _ = runs
    assert "unicode" not in compiled.stderr
