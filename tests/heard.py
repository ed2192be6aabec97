"""Listeners for tests."""

import signal
from collections.abc import Sequence

from core.report import Report


class Heard(Report):
    """Keeps what it is told, and what was brought to its end;
    warnings begin with `! `, tables become lines (a header too, where there is one)."""

    def __init__(self):
        self.lines: list[str] = []
        self.steps: list[tuple[int, int]] = []
        self.finished: set[str] = set()

    def say(self, line: str) -> None:
        self.lines.append(line)

    def warn(self, line: str) -> None:
        self.lines.append(f"! {line}")

    def progress(self, what: str, done: int, total: int, note: str = "", share: float | None = None) -> None:
        self.steps.append((done, total))
        self.finished |= {what} if done == total else set()

    def table(self, title: str, rows: Sequence[tuple[str, ...]], header: tuple[str, ...] = ()) -> None:
        self.lines += [": ".join(row) for row in ([header, *rows] if header else rows)]


class StopsAtStep(Heard):
    """Ends a training as it is told of its step `step`.
    by: an error, or a signal that the process gets, as from Ctrl-C."""

    def __init__(self, step: int, by: OSError | signal.Signals = signal.SIGINT):
        super().__init__()
        self.step, self.by = step, by

    def progress(self, what: str, done: int, total: int, note: str = "", share: float | None = None) -> None:
        super().progress(what, done, total, note, share)
        if (what, done) == ("Training", self.step):
            if isinstance(self.by, OSError):
                raise self.by
            signal.raise_signal(self.by)
