"""Which files of a folder are photos, and which are copies of others."""

from core.data.photos.folder import START_BYTES, copies_among, list_photos, list_unreadable


def test_list_is_sorted_flat_and_without_hidden_files(tmp_path):
    for name in ("b.JPG", "a.png", "c.jfif", "d.jpe", "e.HEIC", ".hidden.jpg", "notes.txt"):
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "folder.jpg").mkdir()
    assert [path.name for path in list_photos(tmp_path)] == ["a.png", "b.JPG", "c.jfif", "d.jpe", "e.HEIC"]


def test_photos_of_cameras_and_phones_are_told_from_other_files(tmp_path):
    for name in ("a.gif", "b.jxl", "c.pef", "d.SRW", "e.dng", "notes.txt", "f.jpg", "g.heic"):
        (tmp_path / name).write_bytes(b"x")
    assert [path.name for path in list_unreadable(tmp_path)] == ["a.gif", "b.jxl", "c.pef", "d.SRW", "e.dng"]


def test_files_that_only_begin_alike_are_no_copies(tmp_path):
    start = bytes(START_BYTES)
    for name, end in (("a", b"1"), ("b", b"2"), ("c", b"1")):
        (tmp_path / name).write_bytes(start + end)
    a, b, c = (tmp_path / name for name in "abc")
    assert copies_among([a, b, tmp_path / "gone", c]) == {c: a}
