"""Which photos of a collection are not what they were, and which stand far off."""

from dataclasses import replace

import numpy as np
import pytest

from core.data.collection import astray, spread_over
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


def test_the_median_camera_decides_which_cameras_are_astray(tmp_path):
    """The mean of these distances is over 200: beside it nobody would be."""
    photos = small_collection(tmp_path).photos[:5]
    photos = [
        replace(photo, camera=replace(photo.camera, centre=np.array([0, 0, distance])))
        for photo, distance in zip(photos, (1.0, -1.0, 1.0, 99.0, 1000.0), strict=True)
    ]
    assert astray(photos).tolist() == [False, False, False, False, True]
    assert astray(photos, 50.0).tolist() == [False, False, False, True, True]


def test_as_many_as_are_wanted_are_taken_from_the_first_to_the_last():
    assert list(spread_over(range(10), 4)) == [0, 3, 6, 9]
    assert len(spread_over(range(41), 40)) == 40
    assert list(spread_over(range(3), 10)) == [0, 1, 2] and list(spread_over((), 4)) == []
    assert list(spread_over("abc", 1)) == ["a"]


def test_a_photo_is_called_by_its_name_or_what_of_it_is_clear(tmp_path):
    photos = small_collection(tmp_path).photos
    names = ("a/1.jpg", "b/1.jpg", "b/2.png.jpg", "2019.05.jpg", "3.jpg", "3.jpg.png")
    collection = replace(
        small_collection(tmp_path),
        photos=tuple(replace(photo, name=name) for photo, name in zip(photos, names, strict=False)),
    )

    def called(word):
        photo = collection.called(word)
        return photo and photo.name

    assert [called(word) for word in ("a/1.jpg", "a/1", "b/2.png", "b/2", "2", "2.png.jpg", "2019.05")] == [
        "a/1.jpg"
    ] * 2 + ["b/2.png.jpg"] * 4 + ["2019.05.jpg"]
    assert [called(word) for word in ("1", "1.jpg", "2019", "c/2", "3")] == [None] * 5
    assert called("3.jpg") == "3.jpg"


def test_a_photo_that_macos_named_is_called_as_one_types(tmp_path):
    collection = small_collection(tmp_path)
    collection = replace(
        collection,
        photos=(replace(collection.photos[0], name="a/e\N{COMBINING ACUTE ACCENT}te.jpg"), *collection.photos[1:]),
    )
    for word in ("éte.jpg", "éte", "a/éte", collection.photos[0].name):
        assert collection.called(word) is collection.photos[0]
