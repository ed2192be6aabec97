"""Lines about photos: counted, named, and which of them ask for nothing."""

from core.words import Note, Reasons, name_them


def test_reasons_stand_in_the_order_in_which_they_came_up():
    reasons = Reasons()
    for what, name, harmless in (("gone", "b.jpg", False), ("turned", "a.jpg", True), ("gone", "a.jpg", False)):
        reasons.add(what, name, harmless)
    assert reasons.notes() == ["2 photos gone: b.jpg, a.jpg", "1 photo turned: a.jpg"]
    assert [note.harmless for note in reasons.notes()] == [False, True]
    assert Reasons().notes() == []


def test_a_note_is_its_text():
    assert Note("text", harmless=True) == "text" and not Note("text").harmless
    assert name_them("gone", []) == []
