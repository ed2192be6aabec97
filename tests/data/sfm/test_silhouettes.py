"""Points of things that were cut out: where all photos show something, features or not."""

import json

import numpy as np
import pytest

from core.config import Settings
from core.data import load_collection
from core.data.prepare import prepared
from core.data.sfm.silhouettes import points_in_silhouettes
from core.errors import BadInput
from core.report import Report
from tests.data.converted import write_json
from tests.data.room_corner import write_corner
from tests.heard import Heard
from tests.training.transparent_scene import write_transparent_scene


@pytest.fixture
def balls(tmp_path):
    """A Blender scene of smooth balls that end at 0.9, without points."""
    return with_facts(write_transparent_scene(tmp_path / "balls"), lambda facts: facts.pop("ply_file_path"))


def with_facts(root, change):
    for path in root.glob("transforms_*.json"):
        facts = json.loads(path.read_text())
        change(facts)
        write_json(path, facts)
    return root


@pytest.mark.parametrize(("scale", "shift"), [(1, 0), (50, 700)])
def test_where_nothing_has_features_points_fill_the_silhouettes(balls, tmp_path, scale, shift):
    def elsewhere(facts):
        for frame in facts["frames"]:
            for row in frame["transform_matrix"][:3]:
                row[3] = scale * row[3] + shift

    heard = Heard()
    collection = prepared(with_facts(balls, elsewhere), tmp_path / "points", heard)
    far = np.linalg.norm((collection.frame.to_world(collection.points) - shift) / scale, axis=1)
    assert len(far) > 1000 and far.max() < 1.1 and np.median(far) > 0.4
    assert len(np.unique(collection.point_colours, axis=0)) > 100
    assert "at random added to 0 triangulated, where no photo shows empty space" in "\n".join(heard.lines)
    again = prepared(balls, tmp_path / "points", heard)
    assert np.array_equal(again.points, collection.points) and not (tmp_path / "points-2").exists()


def test_other_scenes_have_silhouettes_where_transparency_is_said_to_mean_empty_space(balls, tmp_path):
    (balls / "transforms_train.json").rename(balls / "transforms.json")
    for path in balls.glob("transforms_*.json"):
        path.unlink()
    with pytest.raises(BadInput, match="No point could be triangulated"):
        prepared(balls, tmp_path / "points", Report())
    collection = prepared(balls, tmp_path / "points", Report(), Settings(transparency="empty"))
    assert collection.kind == "nerfstudio" and len(collection.points) > 1000
    with pytest.raises(BadInput, match="No point could be triangulated"):  # those points are not taken for others
        prepared(balls, tmp_path / "points", Report())


def test_cameras_that_look_away_give_no_points(balls, tmp_path):
    def turned(facts):
        for frame in facts["frames"]:
            frame["transform_matrix"] = (np.array(frame["transform_matrix"]) * [1, -1, -1, 1]).tolist()

    with pytest.raises(BadInput, match="No point could be triangulated.*poses are in the axes of its format"):
        prepared(with_facts(balls, turned), tmp_path / "points", Report())


def test_photos_without_empty_space_have_no_silhouettes(tmp_path):
    photos = load_collection(write_corner(tmp_path)).photos
    assert not len(points_in_silhouettes([(photo, photo.camera) for photo in photos], Report())[0])
