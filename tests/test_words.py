"""Lines about photos: they count and name them, and some ask for nothing."""

from core.words import Note, Reasons, counted, name_them


def test_one_thing_is_counted_in_the_singular():
    assert [counted(number, "point") for number in (0, 1, 2, 12_345)] == [
        "0 points",
        "1 point",
        "2 points",
        "12,345 points",
    ]


def test_reasons_are_listed_in_the_order_in_which_they_came_up():
    reasons = Reasons()
    for what, name, harmless in (("gone", "b.jpg", False), ("turned", "a.jpg", True), ("gone", "a.jpg", False)):
        reasons.add(what, name, harmless)
    assert reasons.notes() == [Note("2 photos gone: b.jpg, a.jpg"), Note("1 photo turned: a.jpg", harmless=True)]


def test_no_photos_make_no_note():
    assert name_them("gone", []) == [] and Reasons().notes() == []
