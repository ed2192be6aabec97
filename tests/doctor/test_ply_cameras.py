"""What the cameras beside a .ply tell of it: pixels, and what no photo shows; and damaged ones."""

import json

import pytest

from tests.doctor.examined import asked_for, examined
from tests.doctor.plies import cameras_json, refuse, sound_rows, write


@pytest.mark.parametrize("folder", [".", "point_cloud/iteration_7"])
def test_cameras_of_the_run_folder_tell_pixels_and_what_no_photo_shows(tmp_path, folder):
    (tmp_path / folder).mkdir(parents=True, exist_ok=True)
    rows = sound_rows()
    rows["z"][:100] = -9.0  # behind the camera
    rows["opacity"] = -3.0  # nothing hides another
    path = write(tmp_path / folder / "point_cloud.ply", rows)
    (tmp_path / "cameras.json").write_text(cameras_json((0.0, 0.0, -4.0)))
    for given in (path, tmp_path) if folder != "." else (path,):
        findings, _ = examined(given)
        assert findings["never seen"].figure == "100 (25 %)" and findings["never seen"].advice
        assert "px in the median of 1 camera" in findings["float32 positions"].figure


def test_gaussians_too_large_to_draw_do_not_end_the_examination(tmp_path, monkeypatch):
    monkeypatch.setattr("core.doctor.views.largest_contributions", refuse)
    (tmp_path / "cameras.json").write_text(cameras_json((0.0, 0.0, -4.0)))
    findings, _ = examined(write(tmp_path / "a.ply", sound_rows()))
    assert asked_for(findings) == {"never seen"} and "-r" not in findings["never seen"].advice


def test_the_principal_point_of_a_camera_is_used(tmp_path):
    rows = sound_rows()
    rows["opacity"] = -3.0
    cameras = json.loads(cameras_json((0.0, 0.0, -4.0)))
    (tmp_path / "cameras.json").write_text(json.dumps([cameras[0] | {"cx": 5000.0}]))
    assert examined(write(tmp_path / "a.ply", rows))[0]["never seen"].figure == "400 (100 %)"


def test_the_rotation_of_a_camera_is_used(tmp_path):
    rows = sound_rows()
    rows["opacity"] = -3.0
    # Camera to world.
    camera = json.loads(cameras_json((-4.0, 0.0, 0.0)))[0] | {"rotation": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]}
    (tmp_path / "cameras.json").write_text(json.dumps([camera]))
    assert examined(write(tmp_path / "a.ply", rows))[0]["never seen"].figure == "none"


def test_what_only_the_second_camera_shows_is_seen(tmp_path):
    rows = sound_rows()
    rows["opacity"], rows["z"][:100] = -3.0, -9.0
    (tmp_path / "cameras.json").write_text(cameras_json((0.0, 0.0, -4.0), (0.0, 0.0, -14.0)))
    assert examined(write(tmp_path / "a.ply", rows))[0]["never seen"].figure == "none"


BROKEN = (
    *({"width": 0}, {"width": -5}, {"width": float("inf")}, {"height": 1 << 70}),
    *({"fx": 0}, {"fx": float("nan")}, {"fx": 1e50}, {"cx": -1e300}),
    *(
        {"position": [0, 0, float("nan")]},
        {"rotation": [[1, 0, 0], [1e50, 1, 0], [0, 0, 1]]},
        {"rotation": [[0, 0, 0]] * 3},
    ),
    {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]},  # mirrored
)


@pytest.mark.parametrize("broken", BROKEN)
def test_cameras_that_cannot_be_drawn_with_are_damaged_ones(tmp_path, broken):
    cameras = json.loads(cameras_json((0.0, 0.0, -4.0)))
    (tmp_path / "cameras.json").write_text(json.dumps([cameras[0] | broken]))
    findings, _ = examined(write(tmp_path / "a.ply", sound_rows()))
    assert asked_for(findings) == {"cameras"}


@pytest.mark.parametrize("text", ["", "[{}]", '[{"position": 3}]'])
def test_damaged_cameras_are_a_finding_and_the_rest_goes_on(tmp_path, text):
    (tmp_path / "cameras.json").write_text(text)
    findings, _ = examined(write(tmp_path / "a.ply", sound_rows()))
    assert asked_for(findings) == {"cameras"} and "never seen" not in findings
