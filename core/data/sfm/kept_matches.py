"""Features and matches outlive a stop: they take nearly all the time of structure from motion, and COLMAP computes nothing again that is in its
database.
"""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from core.data.made import read_mark, write_mark
from core.data.sfm.features import DATABASE
from core.errors import BadInput
from core.report import Report
from core.system.atomic import TEMPORARY, remove
from core.system.lock import taken

MARK = "matches-of.json"  # what the database was made of
KEPT = (f"{DATABASE}*", MARK)
GOES_ON = "The features and matches found so far are kept; type the same again to go on."


@contextmanager
def work_kept_if_stopped(output: Path, made_of: dict[str, Any], report: Report) -> Iterator[Path]:
    """A folder to make the scene `output` in, removed at the end. If the block is stopped instead (Ctrl-C, a kill, a full disk), the database in it
    stays, and the next block finds it there, if that makes its scene of the same things.

    made_of: these things, as JSON. The folder lies where `temporary_folder` would put it. Without locks (core.system.lock), and beside a program
    that makes the same scene, nothing is kept.
    """
    parent, name = (output, "") if output.is_dir() else (output.parent, f".{output.name}")
    work = parent / f"{name}.sfm{TEMPORARY}kept"
    work.mkdir(exist_ok=True)
    with taken(work) as ours:
        if not ours:
            work = Path(mkdtemp(prefix=f"{name}.sfm{TEMPORARY}", dir=parent))
        _empty(work, but=KEPT if read_mark(work / MARK) == made_of else ())
        if (work / DATABASE).exists():
            report.say("Going on with the features and matches that were found before it was stopped.")
        write_mark(work / MARK, made_of)
        done = False
        try:
            yield work
            done = True
        except BadInput:
            done = True
            raise
        except KeyboardInterrupt:
            raise KeyboardInterrupt(*[GOES_ON] * (bool(ours) and (work / DATABASE).exists())) from None
        finally:
            keep = bool(ours) and not done and (work / DATABASE).exists()
            with suppress(OSError):
                _empty(work, but=KEPT if keep else ())
                if not keep:
                    work.rmdir()


def _empty(folder: Path, but: tuple[str, ...]) -> None:
    """Delete what is in the folder, except what matches one of these patterns."""
    for path in folder.iterdir():
        if not any(path.match(pattern) for pattern in but):
            remove(path)
