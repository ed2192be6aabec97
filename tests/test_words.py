"""Lines about photos: counted, named, and which of them ask for nothing."""

from core.words import Note, Reasons, name_them


def test_reasons_stand_in_the_order_in_which_they_came_up():
    reasons = Reasons()
    for what, name, harmless in (("gone", "b.jpg", False), ("turned", "a.jpg", True), ("gone", "a.jpg", False)):
        reasons.add(what, name, harmless)
    assert reasons.notes() == [Note("2 photos gone: b.jpg, a.jpg"), Note("1 photo turned: a.jpg", harmless=True)]


def test_of_no_photos_nothing_is_said():
    assert name_them("gone", []) == [] and Reasons().notes() == []
