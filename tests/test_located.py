"""Held-out photos given as unknown files: they are located, refined from there,
and scored beside a refinement from the known camera."""

import cv2
import numpy as np
from click.testing import CliRunner

from core.data.prepare import prepared
from core.report import QUIET
from samples import located
from tests.data.room_corner import HEIGHT, WIDTH, write_corner
from tests.small import finished, whole_settings


def test_located_photos_are_scored_and_the_others_named(tmp_path):
    scene = write_corner(tmp_path, count=9)  # 0 and 8 are held out
    cv2.imwrite(str(scene / "8.png"), np.full((HEIGHT, WIDTH, 3), 128, np.uint8))
    collection = prepared(scene, tmp_path / "points", QUIET)
    small = {
        "steps": 20,
        "max_gaussians": 800,
        "sky_gaussians": 100,
        "encoder_side_px": 48,
        "checkpoints": 1,
        "held_out_checks": 0,
    }
    finished(collection, whole_settings(**small), tmp_path / "run")
    told = CliRunner().invoke(located.main, [str(tmp_path / "run")], catch_exceptions=False).output.splitlines()
    first, second, total, means = told
    assert (
        first.startswith("0.png: ")
        and "features agree" in first
        and second == "8.png: not found"
        and total == "1 of 2 found"
    )
    off = float(means.split()[1])
    encoded, refined, known = (float(part.split(" dB")[0].split()[-1]) for part in means.split("; ")[1].split(", "))
    assert off < 2 and abs(refined - known) < 0.5 and 5 < encoded < 40
