"""Held-out photos given as unknown files: they are refined from where they are located,
and scored beside a refinement from the known camera."""

from dataclasses import replace

from click.testing import CliRunner

from core.data.prepare import prepared
from core.looks.locate import Located
from core.report import QUIET
from samples import located
from tests.data.room_corner import write_corner
from tests.small import finished, whole_settings


def test_located_photos_are_scored_and_the_others_named(tmp_path, monkeypatch):
    """One of which is found where it was taken, but for a small step."""
    collection = prepared(write_corner(tmp_path, count=9), tmp_path / "points", QUIET)  # 0 and 8 are held out
    camera = collection.photo("0.png").camera
    found = Located(replace(camera, centre=camera.centre + 0.002), 30, 40)
    monkeypatch.setattr(located, "locate", lambda trained, look, path, *_: found if path.stem == "0" else None)
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
    assert first.startswith("0.png: 30 of 40 places agree, ")
    assert second == "8.png: not found" and total == "1 of 2 found"
    off = float(means.split()[1])
    encoded, refined, known = (float(part.split(" dB")[0].split()[-1]) for part in means.split("; ")[1].split(", "))
    assert 0 < off < 2 and abs(refined - known) < 0.5 and 5 < encoded < 40
