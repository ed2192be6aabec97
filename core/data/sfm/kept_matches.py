"""Keeps features and matches after a stop: they take nearly all the time of structure from motion,
and COLMAP skips what its database has."""

import hashlib
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from core.data.made import read_mark
from core.data.sfm.features import DATABASE
from core.errors import as_disk_full, as_out_of_memory, disk_full
from core.report import Report
from core.system.atomic import KEPT, NAME_PART, named_if_full, parent_for, remove, temporary_folder, write_json
from core.system.lock import taken

MARK = "matches-of.json"  # what the database was made of
KEPT_FILES = (f"{DATABASE}*", MARK)  # of the work folder; SQLite puts files of its own beside a database


@contextmanager
def work_kept_if_stopped(output: Path, report: Report) -> Iterator[Path]:
    """A work folder, in `parent_for` the output, to make the scene `output` in; removed at the end.

    If the block is stopped by Ctrl-C, a kill, a full disk or lack of memory, the database in the folder is kept for the
    next block. Nothing is kept if the disk has no locks (core.system.lock), or while another program makes the same
    scene.
    """
    name = output.resolve().name
    work = (
        parent_for(output)
        / f".{name[:NAME_PART]}-{hashlib.sha256(name.encode('utf-8', 'surrogateescape')).hexdigest()[:8]}{KEPT}"
    )
    work.mkdir(exist_ok=True)
    with taken(work) as ours:
        if not ours:
            if ours is None:
                with suppress(OSError):  # removed by a program that makes the same scene
                    work.rmdir()
            with temporary_folder(output) as other:
                yield other
            return
        keep = False
        _empty(work, but=KEPT_FILES)
        try:
            # Before the copies of the photos are removed, which makes room again.
            with named_if_full(work, disk_full(output)):
                yield work
        except BaseException as problem:
            stopped = isinstance(problem, KeyboardInterrupt) or as_disk_full(problem) or as_out_of_memory(problem)
            keep = bool(stopped) and (work / DATABASE).exists()
            raise
        finally:
            if keep:
                report.say(
                    f"The features and matches found so far are kept in {work}: the same command goes on from there."
                )
            with suppress(OSError):
                _empty(work, but=KEPT_FILES if keep else ())
                if not keep:
                    work.rmdir()


def keep_if_of(made_of: dict[str, Any], work: Path, report: Report) -> None:
    """Keep the database in `work` if it is sound and was made of the same things (JSON) as noted there;
    else remove it, and note these."""
    if read_mark(work / MARK) == made_of and _is_sound(work / DATABASE):
        report.say("Going on with the features and matches that were found before it was stopped.")
        return
    for path in list(work.glob(f"{DATABASE}*")):
        path.unlink()
    write_json(work / MARK, made_of)


def _is_sound(database: Path) -> bool:
    if not database.is_file():
        return False
    try:
        with closing(sqlite3.connect(database)) as connection:
            return connection.execute("PRAGMA quick_check").fetchone() == ("ok",)
    except sqlite3.Error:
        return False


def _empty(folder: Path, but: tuple[str, ...]) -> None:
    """Delete what is in the folder, except what matches one of these patterns."""
    for path in list(folder.iterdir()):
        if not any(path.match(pattern) for pattern in but):
            remove(path)
