"""The mistakes a user can make, as exceptions that say what, where and what to do."""

import errno
import shlex
from pathlib import Path


class WegsError(Exception):
    """A user's mistake: shown as one line, exit code 1, never as a traceback.

    `what` names the fault with the offending value or path; `fix` says what to type or change.
    """

    def __init__(self, what: str, fix: str = ""):
        self.what = what
        self.fix = fix
        super().__init__(f"{what} {fix}".strip())


class BadInput(WegsError):
    """A file, folder or photo that cannot be used."""


class BadSetting(WegsError):
    """A setting that does not exist, or a value outside its range."""


class TrainingStopped(WegsError):
    """Training could not go on; a checkpoint was written. `fix` says what to change before training again."""


LESS_MEMORY = "Train on smaller photos (-r 320: 320 px wide) or with a lower --max-gaussians"  # what to do where memory runs out


def not_made(folder: Path, problem: OSError) -> BadInput:
    """The error for a folder of results that the system refuses to make."""
    return BadInput(f"The folder {folder} could not be made: {problem.strerror}.", "Choose another -o.")


FULL = (errno.ENOSPC, errno.EDQUOT)


def disk_full(what: str | Path) -> WegsError:
    """The error for `what`, which could not be written because the disk, or the user's share of it, is full (FULL)."""
    return WegsError(f"The disk is full: {what} was not written.", "Free some space and run it again.")


def command(*words: str | Path) -> str:
    """A command line to type; a word with spaces is quoted, so that it can be pasted, and no path reads as an option."""
    return shlex.join(f"./{word}" if isinstance(word, Path) and str(word).startswith("-") else str(word) for word in words)
