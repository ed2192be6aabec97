"""Paths that are kept relative to the folder they are moved with."""

from pathlib import Path

import pytest

from core.data.made import path_from


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """Beside the current folder: a scene, of whose photos the first is a link to one outside,
    and a link to the scene."""
    folder = tmp_path / "scene"
    for part in (folder / "images", folder / "sparse", tmp_path / "data", tmp_path / "here"):
        part.mkdir(parents=True)
    for photo in (tmp_path / "data" / "a.jpg", folder / "images" / "b.jpg"):
        photo.touch()
    (folder / "images" / "a.jpg").symlink_to(tmp_path / "data" / "a.jpg")
    (tmp_path / "link").symlink_to(folder)
    monkeypatch.chdir(tmp_path / "here")
    return folder


def test_a_path_is_the_same_however_the_folder_is_spelt(scene, tmp_path):
    for root in (scene, tmp_path / "link", Path("../scene"), Path("../link")):
        assert [path_from(root, root / "images" / name) for name in ("a.jpg", "b.jpg")] == [
            "images/a.jpg",
            "images/b.jpg",
        ]
        assert path_from(root, root / "sparse" / ".." / "images" / "a.jpg") == "images/a.jpg"
        assert path_from(root, tmp_path / "data" / "a.jpg") == "../data/a.jpg"


def test_a_way_back_through_a_link_leads_where_the_system_says(scene, tmp_path):
    (scene / "elsewhere").symlink_to(tmp_path / "data")
    (tmp_path / "images").mkdir()
    assert path_from(scene, scene / "elsewhere" / ".." / "images") == "../images"
