"""Lists of file names in a transforms.json, which split its photos."""

import pytest

from core.data import load_collection
from core.errors import BadInput
from tests.data.checks import notes_with
from tests.data.converted import changed


def named(*numbers):
    return [f"images/photo_{number}.png" for number in numbers]


def splits(collection):
    return {int(photo.name[6]): photo.split for photo in collection.photos}


@pytest.mark.parametrize(
    ("lists", "expected", "note"),
    [
        ({"train": named(0, 1), "test": named(2, 3)}, {0: "train", 1: "train", 2: "test", 3: "test"}, None),
        ({"train": named(0, 1), "val": named(2)}, {0: "train", 1: "train", 2: "test"}, "not used: photo_3.png"),
        ({"train": named(0), "val": named(1), "test": named(2, 3)}, {0: "train", 2: "test", 3: "test"}, "for testing, not used: photo_1.png"),
        ({"train": named(0, 1), "test": named(1, 2)}, {0: "train", 1: "test", 2: "test"}, "in both train_filenames and test_filenames, held out: photo_1.png"),
        ({"train": named(0, 1), "val": named(1, 2)}, {0: "train", 1: "test", 2: "test"}, "in both train_filenames and val_filenames, held out: photo_1.png"),
        ({"train": named(0, 1, 2)}, {0: "train", 1: "train", 2: "train"}, "holds out no photo"),
        ({"train": ["photo_0.png", "photo_1"], "test": ["./images/photo_2.png", "photo_3.png"]}, {0: "train", 1: "train", 2: "test", 3: "test"}, None),
        ({"test": named(0)}, {0: "test", 1: "train", 2: "train", 3: "train"}, None),
        ({"val": named(1), "test": []}, {0: "train", 1: "test", 2: "train", 3: "train"}, None),
        ({"train": named(0, 9), "test": named(2)}, {0: "train", 2: "test"}, "listed in transforms.json without a usable frame: photo_9.png"),
    ],
)  # fmt: skip
def test_lists_of_file_names_split_the_photos(scene, lists, expected, note):
    collection = load_collection(
        changed(scene, lambda facts: facts.update({f"{name}_filenames": names for name, names in lists.items()}))
    )
    assert splits(collection) == expected
    assert note is None or notes_with(collection, note)
    assert not notes_with(load_collection(scene, all_photos=True), "in both")


@pytest.mark.parametrize(
    ("lists", "words"),
    [
        ({"test": named(0, 1, 2, 3)}, "transforms.json leaves no photo to train on. .* --all-photos"),
        (
            {"train": [], "test": named(0)},
            "leaves no photo to train on: 3 photos listed neither for training nor for testing",
        ),
        (
            {"train": named(9), "test": named(0)},
            "leaves no photo to train on: 1 photo listed in transforms.json without a usable frame: photo_9.png",
        ),
        ({"train": 3}, "has a ..._filenames that is not a list of file names"),
    ],
)
def test_lists_that_leave_nothing_to_train_on_are_refused(scene, lists, words):
    changed(scene, lambda facts: facts.update({f"{name}_filenames": names for name, names in lists.items()}))
    with pytest.raises(BadInput, match=words):
        load_collection(scene)


def test_a_test_list_beside_counts_where_the_file_says_nothing(scene):
    (scene / "test.txt").write_text("photo_3.png\n")
    assert splits(load_collection(scene)) == {0: "train", 1: "train", 2: "train", 3: "test"}
