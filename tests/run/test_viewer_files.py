"""The files that viewers of the original 3DGS project read beside the Gaussians."""

import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
import plyfile

from core.run import run_folders
from tests.small import small_settings


def test_cameras_json_leads_back_to_the_world(tmp_path, collection):
    run_folders.create(tmp_path / "run", collection, small_settings())
    entries = json.loads((tmp_path / "run" / "cameras.json").read_text())
    assert [entry["id"] for entry in entries] == list(range(len(collection.photos)))
    assert [entry["img_name"] for entry in entries][-2:] == ["photo_2.png", "photo_5.png"]  # test photos last
    photo = collection.photos[1]  # turned by 60 degrees
    entry = next(entry for entry in entries if entry["img_name"] == photo.name)
    point = collection.points[0]
    from_file = np.array(entry["rotation"]).T @ (collection.frame.to_world(point) - np.array(entry["position"]))
    expected = photo.camera.world_to_camera @ (point - photo.camera.centre) * collection.frame.radius
    np.testing.assert_allclose(from_file, expected, atol=1e-12)  # float64, numbers of size 1e2
    assert (entry["fx"], entry["width"]) == (50.0, 48)


def test_cfg_args_is_the_namespace_that_viewers_expect(tmp_path, collection, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_folders.create(Path("run"), replace(collection, root=Path("scene")), small_settings())
    fields = eval((tmp_path / "run" / "cfg_args").read_text(), {"Namespace": Namespace})
    assert [fields.source_path, fields.model_path] == [str(Path(name).resolve()) for name in ("scene", "run")]
    assert fields.sh_degree == 3  # our files always have 45 f_rest columns, whatever degree was trained


def test_input_ply_holds_the_points_in_world_units(tmp_path, collection):
    run_folders.create(tmp_path / "run", collection, small_settings())
    rows = plyfile.PlyData.read(str(tmp_path / "run" / "input.ply"))["vertex"].data
    world = collection.frame.to_world(collection.points)
    np.testing.assert_array_equal(np.stack([rows[axis] for axis in "xyz"], 1), world.astype(np.float32))
