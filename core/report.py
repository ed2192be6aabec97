"""How the engine tells what it does. Imports nothing of the engine, so that every layer may speak."""

from collections.abc import Callable

Told = Callable[[int, int], None]  # called with the parts of some work that are done, and their number


def unheard(done: int, total: int) -> None:
    """A Told that nobody hears of."""


class Report:
    """A listener that hears everything and says nothing; the command line has one that prints."""

    def say(self, line: str) -> None:
        """A finding or decision, one line."""

    def warn(self, line: str) -> None:
        """Something dropped or suspicious, one line."""

    def progress(self, what: str, done: int, total: int, note: str = "", share: float | None = None) -> None:
        """`done` of `total` parts of `what` are through; `note` holds figures for the end of the bar.

        share: of the time for all of them that is through, in [0, 1]; None if they all take as long.
        """

    def table(self, title: str, rows: list[tuple[str, ...]], header: tuple[str, ...] = ()) -> None:
        """Names and values, at the end of something; with a header, columns of any number."""


QUIET = Report()
