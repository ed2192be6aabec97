"""Which photos of a collection are not what they were."""

from dataclasses import replace

import pytest

from tests.small import small_collection


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_photo_whose_camera_moved_has_changed(tmp_path, axis):
    before = small_collection(tmp_path)
    assert before.changed_since(before) == []
    first, second, *rest = before.photos
    centre = second.camera.centre.copy()
    centre[axis] += 0.1
    moved = replace(second, camera=replace(second.camera, centre=centre))
    after = replace(before, photos=(first, moved, *rest))
    assert after.changed_since(before) == before.changed_since(after) == ["photo_1.png"]


def test_photos_that_came_went_or_are_held_out_now_have_changed(tmp_path):
    before = small_collection(tmp_path)
    first, second, *rest = before.photos
    after = replace(before, photos=(replace(first, split="test"), replace(second, name="new.png"), *rest))
    assert after.changed_since(before) == ["new.png", "photo_0.png", "photo_1.png"]
