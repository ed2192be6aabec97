"""A listener for tests."""

from core.report import Report


class Heard(Report):
    """Keeps what it is told, and what was brought to its end; warnings begin with `! `, tables become lines (a header too, where there is one)."""

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

    def table(self, title: str, rows: list[tuple[str, ...]], header: tuple[str, ...] = ()) -> None:
        self.lines += [": ".join(row) for row in ([header] if header else []) + rows]
