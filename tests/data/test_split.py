"""Splits: what a .tsv, a test.txt or neither says about the photos at hand."""

import pytest

from core.data import load_collection
from core.data.photos.names import rows_that_mean
from core.data.split import split_photos
from core.data.split_table import read_split_table
from core.errors import BadInput
from tests.data.checks import texts_of
from tests.data.small_scene import SmallScene
from tests.real_data import real

NAMES = [f"{letter}.jpg" for letter in "abcdefghijklmnopq"]


def table(*rows):
    return "\n".join(["filename\tid\tsplit\tdataset", *("\t".join(row) for row in rows)]) + "\n"


def split(root, names=NAMES):
    """The split of the photos, and what is said of it."""
    splits, notes, _ = split_photos(root, root / "sparse" / "0", names, set(names))
    return splits, texts_of(notes)


def test_every_eighth_by_name_is_held_out_without_a_list(tmp_path):
    splits, notes = split(tmp_path)
    assert [name for name in NAMES if splits[name] == "test"] == ["a.jpg", "i.jpg", "q.jpg"]
    assert set(splits) == set(NAMES) and "every 8th photo" in notes[0] and "`--all-photos` trains on all" in notes[0]


def test_which_of_two_rows_means_a_photo_does_not_depend_on_their_order():
    rows = ["A.jpg", "a.jpg"]
    meant = [rows_that_mean(["a.JPG"], dict.fromkeys(order).keys())[0] for order in (rows, rows[::-1])]
    assert meant[0] == meant[1] and len(meant[0]) == 1


def test_one_photo_is_trained_on(tmp_path):
    assert split(tmp_path, ["a.jpg"])[0] == {"a.jpg": "train"}


def test_photos_in_test_txt_are_held_out(tmp_path):
    (tmp_path / "test.txt").write_text("# held out\r\nc.jpg\r\n\r\nd.jpg\r\nunknown.jpg\r\n")
    splits, notes = split(tmp_path)
    assert [name for name in NAMES if splits[name] == "test"] == ["c.jpg", "d.jpg"]
    assert notes == ["1 photo of test.txt not in the model: unknown.jpg"]


def test_names_may_differ_in_case_where_none_is_equal(tmp_path):
    (tmp_path / "test.txt").write_text("A.JPG\nC.jpg\nX.JPG\n")
    splits, notes = split(tmp_path, ["a.jpg", "b.jpg", "c.jpg", "C.jpg"])
    assert splits == {"a.jpg": "test", "b.jpg": "train", "c.jpg": "train", "C.jpg": "test"}
    assert notes == ["1 photo of test.txt not in the model: X.JPG"]
    (tmp_path / "test.txt").write_text("A.JPG\n")
    splits, notes = split(tmp_path, ["left/a.jpg", "right/a.jpg", "b.jpg"])
    assert set(splits.values()) == {"train"} and "A.JPG (left/a.jpg, right/a.jpg)" in notes[0]


def test_a_table_above_the_folder_and_a_list_without_its_other_half_are_reported(tmp_path):
    (tmp_path / "x.tsv").write_text(table(("a.jpg", "1", "train", "x"), ("b.jpg", "2", "test", "x")))
    (tmp_path / "dense").mkdir()
    (tmp_path / "dense" / "train_list.txt").write_text("a.jpg\n")
    _, notes = split(tmp_path / "dense", NAMES[:2])
    assert notes[1:] == [
        f"{tmp_path / 'x.tsv'} is not used: give the folder it is in, {tmp_path}, to split by it.",
        "train_list.txt is not used: there is no test_list.txt beside it.",
    ]
    (tmp_path / "dense").rename(tmp_path / "other")
    assert len(split(tmp_path / "other", NAMES[:2])[1]) == 2


def test_test_txt_beside_the_model(tmp_path):
    root = SmallScene().write(tmp_path / "scene")
    (root / "sparse" / "0" / "test.txt").write_text("photo_2.png\n")
    assert [photo.name for photo in load_collection(root).split("test")] == ["photo_2.png"]
    (root / "test.txt").write_text("photo_1.png\n")
    assert [photo.name for photo in load_collection(root).split("test")] == ["photo_1.png"]


def test_lists_may_be_in_any_letters_and_between_the_scene_and_its_model(tmp_path):
    root = SmallScene().write(tmp_path / "scene", images="dense/images", sparse="dense/sparse")
    held_out = []
    for number, place in enumerate(("dense/Test.TXT", "dense/sparse/TEST.txt", "test.txt")):
        (root / place).write_text(f"photo_{number}.png\n")
        held_out += [photo.name for photo in load_collection(root).split("test")]
    for number, place in enumerate(("dense/NERFW_SPLIT.CSV", "PLAZA.TSV")):
        rows = [(f"photo_{photo}.png", "1", "test" if photo == number else "train", "x") for photo in range(4)]
        (root / place).write_text(table(*rows))
        held_out += [photo.name for photo in load_collection(root).split("test")]
    assert held_out == [f"photo_{number}.png" for number in (0, 1, 2, 0, 1)]


def test_tsv_beats_test_txt_and_drops_what_it_must(tmp_path):
    (tmp_path / "test.txt").write_text("a.jpg\n")
    rows = [("a.jpg", "1.0", "train", "x"), ("b.jpg", "2.0", "test", "x"), ("c.jpg", "", "train", "x")]
    rows += [
        ("d.jpg", "nan", "test", "x"),
        ("e.jpg", "5", "other", "x"),
        ("gone.jpg", "6.0", "test", "x"),
        ("", "", "", ""),
    ]
    (tmp_path / "church.tsv").write_text(table(*rows), encoding="utf-8")
    splits, notes = split(tmp_path, NAMES[:6])
    assert splits == {"a.jpg": "train", "b.jpg": "test"}
    assert notes == [
        "2 photos of church.tsv without an id, not used: c.jpg, d.jpg",
        "1 photo of church.tsv in neither train nor test, not used: e.jpg",
        "1 photo of church.tsv not in the model: gone.jpg",
        "1 photo not in church.tsv, not used: f.jpg",
    ]


def test_names_in_another_form_of_unicode_are_the_same_names(tmp_path):
    (tmp_path / "test.txt").write_text("Pl\u00e4tze.jpg\n", encoding="utf-8")
    splits, notes = split(tmp_path, ["Pla\u0308tze.jpg", "b.jpg"])
    assert splits == {"Pla\u0308tze.jpg": "test", "b.jpg": "train"} and not notes


def test_tsv_matches_photos_in_folders_by_their_last_name(tmp_path):
    (tmp_path / "x.tsv").write_text(table(("a.jpg", "1", "train", "x"), ("b.jpg", "2", "test", "x")))
    splits, notes = split(tmp_path, ["left/a.jpg", "left/b.jpg"])
    assert splits == {"left/a.jpg": "train", "left/b.jpg": "test"} and notes == []


def test_the_first_of_several_split_tables_is_used(tmp_path):
    for name in ("a.tsv", "b.tsv"):
        (tmp_path / name).write_text(table(("a.jpg", "1", "train", "x"), ("b.jpg", "2", "test", "x")))
    assert split(tmp_path, NAMES[:2])[1] == ["Several split tables: a.tsv is used, b.tsv not."]


def test_no_test_photo_is_noted(tmp_path):
    (tmp_path / "x.tsv").write_text(table(("a.jpg", "1", "train", "x")))
    assert "holds out none" in split(tmp_path, ["a.jpg"])[1][0]


def test_no_photo_to_train_on_is_refused_unless_held_out_ones_are_asked_for(tmp_path):
    names = [f"photo_{index}.png" for index in range(4)]
    root = SmallScene().write(tmp_path / "scene")
    (root / "x.tsv").write_text(table(*((name, "1", "test", "x") for name in names)))
    with pytest.raises(
        BadInput, match="x.tsv leaves no photo to train on. Correct or remove x.tsv, or .* --all-photos"
    ):
        load_collection(root)
    assert [photo.name for photo in load_collection(root, all_photos=True).split("train")] == names
    (root / "x.tsv").write_text(table(("z", "1", "train", "x")))
    for all_photos in (False, True):
        with pytest.raises(
            BadInput,
            match=f"on: 1 photo of x.tsv not in the model: z; 4 photos not in x.tsv, not used: {names[0]}.*remove x.tsv.$",
        ):
            load_collection(root, all_photos)


def test_a_split_in_capitals_and_a_folder_named_like_a_table(tmp_path):
    (tmp_path / "a.tsv").mkdir()
    (tmp_path / "x.tsv").write_text(table(("a.jpg", "1", "Train", "x"), ("b.jpg", "2", "TEST", "x")))
    assert split(tmp_path, NAMES[:2]) == ({"a.jpg": "train", "b.jpg": "test"}, [])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"filename\tid\n", "names no photos"),
        (b"filename\tid\na.jpg\t1\n", "is not a split table"),
        (b"filename\tid\tsplit\n", "names no photos"),
        (b"filename\tid\tsplit\n\xff\xfe\x80\n", "is not in UTF-8. Save it as UTF-8"),
        ("\ufefffilename\tid\tsplit\n".encode("utf-16-le") + b"x", "is not in UTF-16-LE. Save it as UTF-8"),
        (b'filename\tid\tsplit\n"a.jpg\t1\ttrain\nb.jpg\t2\ttest\n', "cannot be read as a table: unexpected end"),
    ],
)
def test_a_split_table_that_cannot_be_read(tmp_path, content, words):
    (tmp_path / "x.tsv").write_bytes(content)
    with pytest.raises(BadInput, match=f"x.tsv {words}"):
        split(tmp_path)


@pytest.mark.parametrize("content", [b"", b"x" * 200_000, b"name\tvalue\n1\t2\n", b"\xff\xfe\x80\n", b"filename\tid\n"])
def test_a_tsv_of_something_else_beside_the_split_is_not_used(tmp_path, content):
    unused = "a.tsv holds no split, not used: its first line does not name filename, id, split, tab-separated."
    (tmp_path / "a.tsv").write_bytes(content)
    (tmp_path / "x.tsv").write_text(table(("a.jpg", "1", "train", "x"), ("b.jpg", "2", "test", "x")))
    splits, notes = split(tmp_path, NAMES[:2])
    assert splits == {"a.jpg": "train", "b.jpg": "test"} and notes == [unused]
    (tmp_path / "x.tsv").unlink()
    if not content.startswith(b"filename"):
        assert split(tmp_path, NAMES[:2])[1][1:] == [unused]


def test_listed_paths_that_end_in_the_name_of_one_photo(tmp_path):
    (tmp_path / "test.txt").write_text("images/a.jpg\nb.jpg\nleft/c.jpg\nright/c.jpg\n")
    splits, notes = split(tmp_path, ["a.jpg", "some/b.jpg", "c.jpg", "other/a.jpg"])
    assert splits == {"a.jpg": "test", "some/b.jpg": "test", "c.jpg": "train", "other/a.jpg": "train"}
    assert notes == ["2 photos of test.txt not in the model: left/c.jpg, right/c.jpg"]
    (tmp_path / "x.tsv").write_text(table(("images/a.jpg", "1", "train", "x"), ("images/b.jpg", "2", "test", "x")))
    assert split(tmp_path, ["a.jpg", "b.jpg"]) == ({"a.jpg": "train", "b.jpg": "test"}, [])


def test_listed_paths_of_windows(tmp_path):
    (tmp_path / "test.txt").write_text("images\\a.jpg\nleft\\b.jpg\nodd\\c.jpg\n")
    splits, notes = split(tmp_path, ["a.jpg", "left/b.jpg", "odd\\c.jpg", "d.jpg"])
    assert splits == {"a.jpg": "test", "left/b.jpg": "test", "odd\\c.jpg": "test", "d.jpg": "train"} and not notes


def test_listed_names_without_a_suffix(tmp_path):
    (tmp_path / "test.txt").write_text("1\n2\nb.png\nright/4\n")
    splits, notes = split(
        tmp_path, ["1.jpg", "11.jpg", "left/1.jpg", "left/2.jpg", "b.png.jpg", "left/4.jpg", "right/4.jpg"]
    )
    assert [name for name in splits if splits[name] == "test"] == [
        "1.jpg",
        "left/2.jpg",
        "b.png.jpg",
        "right/4.jpg",
    ] and not notes


def test_a_listed_name_that_fits_several_photos_means_none_of_them(tmp_path):
    (tmp_path / "test.txt").write_text("a.jpg\n1\nb.jpg\n")
    names = ["left/a.jpg", "right/a.jpg", "left/1.jpg", "left/1.png", "b.jpg", "left/b.jpg"]
    splits, notes = split(tmp_path, names)
    assert [name for name in splits if splits[name] == "test"] == ["b.jpg"]
    fits = "2 photos of test.txt whose name fits several of the model, not used: "
    assert notes == [f"{fits}1 (left/1.jpg, left/1.png), a.jpg (left/a.jpg, right/a.jpg)"]
    (tmp_path / "x.tsv").write_text(table(("a.jpg", "1", "test", "x"), ("b.jpg", "2", "train", "x")))
    splits, notes = split(tmp_path, names)
    assert splits == {"b.jpg": "train"} and "a.jpg (left/a.jpg, right/a.jpg)" in notes[0]


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-be"])
def test_tables_and_lists_as_windows_programs_save_them(tmp_path, encoding):
    mark = "\ufeff" if encoding.endswith("be") else ""
    (tmp_path / "test.txt").write_text(f"{mark}Plätze.jpg\r\nc.jpg\r\n", encoding=encoding)
    names = ["Plätze.jpg", "b.jpg", "c.jpg"]
    expected = {"Plätze.jpg": "test", "b.jpg": "train", "c.jpg": "test"}
    assert split(tmp_path, names) == (expected, [])
    rows = [(name, "1", expected[name], "x") for name in names]
    (tmp_path / "x.tsv").write_text(mark + table(*rows), encoding=encoding)
    (tmp_path / "test.txt").unlink()
    assert split(tmp_path, names) == (expected, [])


def test_rows_that_are_too_short_have_no_id(tmp_path):
    (tmp_path / "x.tsv").write_text("filename\tid\tsplit\na.jpg\nb.jpg\t1\ttrain\n")
    read = read_split_table(tmp_path / "x.tsv")
    assert read.splits == {"b.jpg": "train"} and read.without_id == ("a.jpg",)


def test_a_photo_with_several_rows_is_held_out_if_one_says_so_and_used_if_one_can_be(tmp_path):
    rows = (
        ("a.jpg", "1", "test"),
        ("a.jpg", "2", "train"),
        ("b.jpg", "3", "train"),
        ("b.jpg", "", "train"),
        ("c.jpg", "4", "none"),
        ("c.jpg", "5", "test"),
    )
    (tmp_path / "x.tsv").write_text(table(*((*row, "x") for row in rows)))
    splits, notes = split(tmp_path, ["a.jpg", "b.jpg", "c.jpg"])
    assert splits == {"a.jpg": "test", "b.jpg": "train", "c.jpg": "test"}
    assert notes == ["1 photo in both train and test of x.tsv, held out: a.jpg"]


def test_the_table_that_nerfbaselines_keeps(tmp_path):
    (tmp_path / "nerfw_split.csv").write_text(table(("a.jpg", "1", "test", "x"), ("b.jpg", "2", "train", "x")))
    (tmp_path / "other.csv").write_text(table(("a.jpg", "1", "train", "x")))
    assert split(tmp_path, ["a.jpg", "b.jpg"]) == ({"a.jpg": "test", "b.jpg": "train"}, [])


def test_the_lists_that_nerfbaselines_keeps(tmp_path):
    (tmp_path / "test_list.txt").write_text("b.jpg\n")
    assert split(tmp_path, ["a.jpg", "b.jpg", "c.jpg"]) == ({"a.jpg": "train", "b.jpg": "test", "c.jpg": "train"}, [])
    (tmp_path / "train_list.txt").write_text("a.jpg\nd.jpg\n")
    splits, notes = split(tmp_path, ["a.jpg", "b.jpg", "c.jpg"])
    assert splits == {"a.jpg": "train", "b.jpg": "test"}
    assert notes == [
        "1 photo of train_list.txt not in the model: d.jpg",
        "1 photo neither in test_list.txt nor in train_list.txt, not used: c.jpg",
    ]
    (tmp_path / "train_list.txt").write_text("a.jpg\nimages/b.jpg\nc.jpg\n")
    splits, notes = split(tmp_path, ["a.jpg", "b.jpg", "c.jpg"])
    assert splits == {"a.jpg": "train", "b.jpg": "test", "c.jpg": "train"}
    assert notes == ["1 photo in both train_list.txt and test_list.txt, held out: b.jpg"]
    (tmp_path / "test.txt").write_text("a.jpg\n")
    assert split(tmp_path, ["a.jpg", "b.jpg", "c.jpg"])[0] == {"a.jpg": "test", "b.jpg": "train", "c.jpg": "train"}


def test_long_lists_are_cut_but_counted(tmp_path):
    (tmp_path / "x.tsv").write_text(
        table(*((name, "", "train", "x") for name in NAMES[:15]), ("q.jpg", "1", "train", "x"))
    )
    note = split(tmp_path)[1][0]
    assert note.startswith("15 photos") and note.endswith("l.jpg and 3 more")


def test_a_phototourism_scene_is_split_by_its_table(tmp_path):
    root = SmallScene().write(tmp_path / "scene", "dense/images", "dense/sparse")
    names = [f"photo_{index}.png" for index in range(4)]
    (root / "plaza.tsv").write_text(
        table(*((name, "1.0", "test" if name == names[1] else "train", "x") for name in names))
    )
    collection = load_collection(root)
    assert collection.kind == "colmap" and collection.notes == ()
    assert [photo.name for photo in collection.split("test")] == [names[1]]


@pytest.mark.parametrize(("name", "train", "test"), [("brandenburg", 763, 10), ("sacre", 830, 21), ("trevi", 1689, 19)])
def test_official_splits(name, train, test):
    """The counts that NeRF-W's own reader gets after dropping rows without an id."""
    splits = list(read_split_table(real("nerfw_splits") / f"{name}.tsv").splits.values())
    assert (splits.count("train"), splits.count("test")) == (train, test)
