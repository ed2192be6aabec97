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
    """A setting that does not exist, or a value outside its range. names: of the settings at fault, where known."""

    def __init__(self, what: str, fix: str = "", names: tuple[str, ...] = ()):
        super().__init__(what, fix)
        self.names = names


class TrainingStopped(WegsError):
    """Training could not go on; a checkpoint was written. `fix` says what to change before training again."""


class DiskFull(WegsError):
    """What was to be written found no room."""


# What to do where memory runs out.
LESS_MEMORY = "Train on smaller photos (-r 320: 320 px wide) or with a lower --max-gaussians"
DISK_FULL = (errno.ENOSPC, errno.EDQUOT)
OPENCV_NO_MEMORY = -4  # the code of a cv2.error


def disk_full(what: str | Path) -> DiskFull:
    """The error for `what`, which could not be written because the disk, or the user's share of it, is full."""
    return DiskFull(f"The disk is full: {what} was not written.", "Free some space and run it again.")


def as_disk_full(problem: BaseException, path: Path | None = None) -> DiskFull | None:
    """The error to show if `problem` means that the disk is full, else None. path: what was being written, if known."""
    if isinstance(problem, OSError) and problem.errno in DISK_FULL:
        return disk_full(path or problem.filename or "a file")
    return problem if isinstance(problem, DiskFull) else None


def as_out_of_memory(problem: BaseException) -> WegsError | None:
    """The error to show if `problem` means that memory ran out,
    for which torch and OpenCV have exceptions of their own; else None."""
    of_torch = str(problem) if isinstance(problem, RuntimeError) else ""
    of_opencv = type(problem).__module__ == "cv2" and getattr(problem, "code", None) == OPENCV_NO_MEMORY
    # torch's own words, CUDA's and Triton's; those of CUDA's libraries.
    if ("CUDA" in of_torch and "out of memory" in of_torch) or "STATUS_ALLOC_FAILED" in of_torch:
        return WegsError(
            "The memory of the GPU ran out.", f"{LESS_MEMORY}, or use the CPU: set CUDA_VISIBLE_DEVICES=-1."
        )
    of_threads = "can't start new thread" in of_torch  # each takes a stack
    if isinstance(problem, MemoryError) or of_opencv or "allocate memory" in of_torch or of_threads:
        return WegsError("There is not enough memory.", f"{LESS_MEMORY}, or raise --memory if it is set.")
    return None


def command(*words: str | Path) -> str:
    """A command line to type; a word with spaces is quoted, so that it can be pasted,
    and no path reads as an option."""
    return shlex.join(
        f"./{word}" if isinstance(word, Path) and str(word).startswith("-") else str(word) for word in words
    )
