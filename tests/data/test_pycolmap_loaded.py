"""What comes with pycolmap does not disturb OpenCV, whichever of them a command loads first."""

from tests.programs import run_python

PROGRAM = """
import core.data  # nothing else before it, as in `wegs train --resume`
import cv2, numpy as np
for size in range(165, 215):
    assert cv2.imencode(".png", np.random.default_rng(size).integers(0, 256, (size, 122), np.uint8))[0]
"""


def test_pngs_can_be_written_once_pycolmap_is_loaded():
    run_python(PROGRAM, timeout_s=120)
