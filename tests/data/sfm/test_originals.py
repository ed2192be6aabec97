"""The name that a scene gives to the photo of a file:
it is found again after the file was moved, unless it changed or could be another."""

import os

from core.data.made import stamp
from core.data.sfm.originals import LENSES, MADE_OF, NAMES, files_of, is_made_of, lenses_of, name_in
from core.system.atomic import write_json


def test_a_moved_photo_is_known_until_it_changes_or_another_of_its_name_is_gone_as_well(tmp_path):
    scene, (first, second) = tmp_path / "scene", [tmp_path / folder / "0.jpg" for folder in "ab"]
    for folder in (scene, first.parent, second.parent):
        folder.mkdir()
    for path in (first, second):
        path.write_bytes(b"photo")
        os.utime(path, ns=(1, 1))
    write_json(scene / MADE_OF, {str(path.resolve()): stamp(path) for path in (first, second)})
    write_json(scene / NAMES, {str(path.resolve()): f"{path.parent.name}.jpg" for path in (first, second)})
    moved = first.rename(tmp_path / "0.jpg")
    assert [name_in(scene, path) for path in (moved, second)] == ["a.jpg", "b.jpg"]
    os.utime(moved, ns=(2, 2))
    assert name_in(scene, moved) is None
    os.utime(moved, ns=(1, 1))
    second.unlink()
    assert name_in(scene, moved) is None  # which of the two is it?


def test_links_to_files_of_one_name_are_told_apart(tmp_path):
    photos, scene = tmp_path / "photos", tmp_path / "scene"
    for folder in (photos, scene, tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
    for name in "ab":
        (tmp_path / name / "0.jpg").write_bytes(name.encode())
        (photos / f"{name}.jpg").symlink_to(tmp_path / name / "0.jpg")
    write_json(scene / MADE_OF, files_of(photos))
    assert is_made_of(scene, files_of(photos))
    (photos / "a.jpg").unlink()
    assert not is_made_of(scene, files_of(photos))


def test_damaged_lenses_are_left_out(tmp_path):
    sound = {"model": "SIMPLE_PINHOLE", "width": 160, "height": 120, "params": [150.0, 80.0, 60.0]}
    lenses = {
        "a.jpg": sound | {"note": "hi"},
        "b.jpg": sound | {"model": "TELESCOPE"},
        "c.jpg": sound | {"params": [150.0]},
    }
    odd = [{"model": ["PINHOLE"]}, {"width": -5}, {"height": 1 << 70}, {"params": None}, {"orientation": [1]}]
    odd += [{"params": [10**400, 80.0, 60.0]}, {"params": [150.0, "80", 60.0]}]
    lenses |= {f"odd_{number}.jpg": sound | values for number, values in enumerate(odd)}
    write_json(tmp_path / MADE_OF, {})
    write_json(tmp_path / LENSES, lenses | {"d.jpg": 7, "e.jpg": {"model": "PINHOLE"}})
    assert list(lenses_of(tmp_path)) == ["a.jpg"] and lenses_of(tmp_path)["a.jpg"].params == sound["params"]
