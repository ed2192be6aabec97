"""The engine's reports on the terminal: bars and tables on a screen, plain lines in a log file."""

import errno
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import timedelta
from math import ceil
from typing import NoReturn, Self

import click
from rich.console import Console
from rich.measure import Measurement
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from core.kernels.compiled import compiling_told
from core.report import Report
from core.words import on_one_line
from wegs_cli.stops import work_begins

WIDE = 80  # columns; a narrower terminal shows what is done and the time left, no bar and no note
NAMING = 2  # the first columns of a table with a header say what its row is about
PLAIN_SECONDS = 15.0  # between two progress lines in a log file


class Pipe(Console):
    """A rich console that leaves a broken pipe to its Terminal; rich itself would end the program."""

    def on_broken_pipe(self) -> NoReturn:
        raise BrokenPipeError


@contextmanager
def _reader_may_leave() -> Iterator[None]:
    """Once a pipe (`| head`) or terminal is closed, drop all further output and let the work go on:
    its files are still wanted."""
    try:
        yield
    except OSError as problem:
        if not isinstance(problem, BrokenPipeError) and problem.errno != errno.EIO:
            raise
        with suppress(OSError, ValueError):  # if standard output is not a file
            nowhere = os.open(os.devnull, os.O_WRONLY)
            # Otherwise Python would complain at exit about what it could not write.
            os.dup2(nowhere, sys.stdout.fileno())
            os.close(nowhere)


class Terminal(Report):
    """A Report for people. Use it as a context manager around the work: leaving it clears the progress bar."""

    def __init__(self):
        self.console = Pipe(markup=False, emoji=False, highlight=False)  # [old] and :sun: are parts of paths
        self.bar: Progress | None = None
        self.what = ""
        self.told = 0.0
        self.compiling = compiling_told(self)

    def __enter__(self) -> Self:
        work_begins()
        self.compiling.__enter__()
        return self

    @_reader_may_leave()
    def __exit__(self, *_) -> None:
        self.compiling.__exit__(None, None, None)
        self._end_bar()

    @_reader_may_leave()
    def say(self, line: str) -> None:
        self._end_bar(if_full=True)
        self.console.print(on_one_line(line), soft_wrap=True)

    @_reader_may_leave()
    def warn(self, line: str) -> None:
        self._end_bar(if_full=True)
        self.console.print(on_one_line(line), style="yellow", soft_wrap=True)

    @_reader_may_leave()
    def progress(self, what: str, done: int, total: int, note: str = "", share: float | None = None) -> None:
        what, note = on_one_line(what), on_one_line(note)
        bar = self._advanced_bar(what, done, total, note, done / max(total, 1) if share is None else share)
        if not self.console.is_terminal and (done == total or time.monotonic() - self.told >= PLAIN_SECONDS):
            self.told = time.monotonic()
            left = bar.tasks[0].time_remaining
            estimate = f", {timedelta(seconds=ceil(left))} left" if left else ""
            click.echo(f"{what} {done}/{total}{estimate}  {note}".rstrip())

    @_reader_may_leave()
    def table(self, title: str, rows: Sequence[tuple[str, ...]], header: tuple[str, ...] = ()) -> None:
        self._end_bar()
        title, rows = on_one_line(title), [tuple(map(on_one_line, row)) for row in rows]
        if not self.console.is_terminal:
            lines = [title, *_aligned([header, *rows])] if header else [": ".join(row) for row in rows]
            for line in lines:
                click.echo(line)
            return
        grid = Table(title=title, title_justify="left", show_header=bool(header))
        for number, name in enumerate(header or [""] * max(map(len, rows))):
            grid.add_column(name, justify="left" if number < NAMING else "right", overflow="fold")
        for row in rows:
            grid.add_row(*row)
        unlimited = self.console.options.update(max_width=sys.maxsize)
        if header and Measurement.get(self.console, unlimited, grid).maximum > self.console.width:
            self.console.print("\n".join([title, *_in_blocks(header, rows)]), soft_wrap=True)
        else:
            self.console.print(grid)

    def _advanced_bar(self, what: str, done: int, total: int, note: str, share: float) -> Progress:
        """The bar, begun or moved on: its length is the share of the time, beside it stands the count of parts.
        It is not drawn in a log file."""
        # The last: the same work, begun on another thing.
        if self.bar is None or what != self.what or share < self.bar.tasks[0].completed:
            self._end_bar()
            name = TextColumn("{task.description}", markup=False)
            count = TextColumn("{task.fields[count]}", markup=False)
            left = [TextColumn("left"), TimeRemainingColumn()]
            columns = [name, count, *left]
            if self.console.width >= WIDE:
                note_told = TextColumn("{task.fields[note]}", markup=False)
                columns = [name, BarColumn(), count, TimeElapsedColumn(), *left, note_told]
            self.bar = Progress(
                *columns, console=self.console, get_time=time.monotonic, disable=not self.console.is_terminal
            )
            self.bar.start()
            self.bar.add_task(what, total=1.0, count="", note="")
            self.what = what
        self.bar.update(self.bar.task_ids[0], completed=share, count=f"{done}/{total}", note=note)
        return self.bar

    def _end_bar(self, if_full: bool = False) -> None:
        """Stop drawing the bar. if_full: only a full one,
        which would otherwise be drawn again below every line that follows."""
        if self.bar is not None and (not if_full or self.bar.finished):
            self.bar.stop()
            self.bar = None


def _in_blocks(header: tuple[str, ...], rows: list[tuple[str, ...]]) -> Iterator[str]:
    """Each row as lines of its own, one figure a line: a narrow table would break numbers in two."""
    for row in rows:
        yield "  ".join(row[:NAMING])
        yield from (f"    {name}: {cell}" for name, cell in zip(header[NAMING:], row[NAMING:], strict=True))


def _aligned(rows: list[tuple[str, ...]]) -> list[str]:
    """The rows as lines with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
