"""A trained run of the room corner, each photo in a light of its own."""

from pathlib import Path

import cv2
import numpy as np

from core.data.prepare import prepared
from core.looks.trained import TrainedRun
from core.report import QUIET
from tests.data.room_corner import write_corner
from tests.small import finished, whole_settings


def lit_corner(folder: Path, steps: int) -> TrainedRun:
    """Six photos of it, of which 0.png is held out, and the run, made in `folder`."""
    scene = write_corner(folder)
    for number in range(6):
        path = str(scene / f"{number}.png")
        tint = np.exp(0.3 * np.random.default_rng(number).normal(size=3))
        cv2.imwrite(path, np.clip(0.7 * tint * cv2.imread(path), 0, 255).astype(np.uint8))
    small = {"max_gaussians": 1500, "sky_gaussians": 100, "encoder_side_px": 48, "checkpoints": 1, "held_out_checks": 0}
    return finished(prepared(scene, folder / "points", QUIET), whole_settings(steps=steps, **small), folder / "run")
