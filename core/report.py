"""How the engine reports what it does. Imports nothing from the engine, so that every layer can use it."""

from collections.abc import Callable, Sequence

OnProgress = Callable[[int, int], None]  # a progress callback: parts done, parts in all


def ignore_progress(done: int, total: int) -> None:
    """An OnProgress that does nothing."""


class Report:
    """Ignores all that it is told; the command line has a subclass that prints it."""

    def say(self, line: str) -> None:
        """A finding or decision, one line."""

    def warn(self, line: str) -> None:
        """Something dropped or suspicious, one line."""

    def progress(self, what: str, done: int, total: int, note: str = "", share: float | None = None) -> None:
        """`done` of `total` parts of `what` are finished; `note` holds figures for the end of the bar.

        share: of the time for all parts, how much has passed, in [0, 1]; None if every part takes equally long.
        """

    def table(self, title: str, rows: Sequence[tuple[str, ...]], header: tuple[str, ...] = ()) -> None:
        """Names and values, at the end of something; with a header, columns of any number."""


QUIET = Report()
