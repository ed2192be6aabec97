"""The blending kernels' vectors: what the compiler makes of them, and processors without wide registers."""

import re

import numpy as np
import pytest

from core.rasterizer import create
from core.rasterizer.cpu.blend_backward import blend_backward
from core.rasterizer.cpu.blend_forward import blend_forward
from tests.afresh import assembly_of
from tests.programs import run_python
from tests.rasterizer.scenes import SCENES
from tests.rasterizer.tolerances import PICTURE


@pytest.mark.parametrize("kernel", [blend_forward, blend_backward], ids=["forward", "backward"])
def test_kernels_use_wide_registers(kernel):
    """The machine code has 256-bit fused multiply-adds: no Numba release may lose them in silence."""
    scene = SCENES["single"]()
    splats = scene.splats.map(lambda tensor: tensor.requires_grad_())
    create("cpu").render(splats, scene.camera).sum().backward()
    assembly = assembly_of(kernel, kernel.signatures[0])
    assert len(re.findall(r"vfn?madd\d+ps\s.*%ymm", assembly)) >= 8
    assert not re.search(r"vfn?madd\d+ss", assembly), "scalar arithmetic in what should be vectors"


RENDER = """
import sys, numpy as np, torch
from core.rasterizer import create
from tests.rasterizer.scenes import SCENES
scene = SCENES["random_degree_1"]()
splats = scene.splats.map(lambda tensor: tensor.requires_grad_())
image = create("cpu").render(splats, scene.camera, scene.background)
image.square().sum().backward()
np.savez(sys.argv[1], image=image.detach(), means=splats.means.grad)
"""


def test_processor_without_wide_registers(tmp_path):
    """Compiled for the oldest x86-64 (or plain ARM): other instructions, the same picture and gradient."""
    pictures = []
    for name, changes in (("own", {}), ("generic", {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""})):
        path = tmp_path / f"{name}.npz"
        run_python(RENDER, path, **changes)
        pictures.append(np.load(path))
    own, generic = pictures
    assert np.abs(own["image"] - generic["image"]).max() <= PICTURE
    # Fused or not, sums of products differ in the last digits.
    assert np.abs(own["means"] - generic["means"]).max() <= 1e-5 * np.abs(own["means"]).max()
