"""The progress bar of a training says what is going on, also during a long step."""

from dataclasses import replace

from core.report import Report
from core.training.tell import tell_step
from core.training.trainer import Trainer
from tests.small import small_collection, small_settings


class Bars(Report):
    """Keeps what stands behind the bar of a training, by step."""

    def __init__(self):
        self.notes: dict[int, list[str]] = {}

    def progress(self, what: str, done: int, total: int, note: str = "", share: float | None = None) -> None:
        if what == "Training":
            assert total == 10 and 0 <= share <= 1
            self.notes.setdefault(done, []).append(note)


def test_the_progress_bar_says_what_a_long_step_is_doing(tmp_path, monkeypatch):
    monkeypatch.setattr("core.training.decisions.FEWEST_FOR_MASKS", 3)
    collection = small_collection(tmp_path, photos=9)
    collection = replace(collection, photos=tuple(replace(photo, split="train") for photo in collection.photos))
    settings, bars = small_settings(steps=10), Bars()
    for step in Trainer(collection, settings, tmp_path, bars).train():
        tell_step(step, settings, bars)
    assert bars.notes.keys() == set(range(1, 11)) and all(notes[0].startswith("loss ") for notes in bars.notes.values())
    in_6th, in_8th = bars.notes[5][1:], bars.notes[7][1:]  # see core.training.schedule
    assert in_6th == [f"pruning: view {seen} of 9" for seen in range(1, 10)] == in_8th[:9]
    assert in_8th[-9:] == [f"passers-by: view {seen} of 9" for seen in range(1, 10)]
    views = len(in_8th) - 18
    assert in_8th[9:-9] == [f"veils: view {seen + 1} of {views}" for seen in range(views)] and 9 < views <= 45
    assert bars.notes[9][1:] == [f"looks: view {seen} of 9" for seen in range(1, 10)]
    assert all(len(notes) == 1 for step, notes in bars.notes.items() if step not in (5, 7, 9))
