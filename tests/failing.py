"""What fails in a test in place of what hardly ever fails:
a full disk, or a file that may not be read. (Root may read any.)"""

import errno
import os
import shutil
from collections.abc import Callable

import cv2
from pytest import MonkeyPatch

from core.looks.find_look import find_look
from core.looks.trained import Look, TrainedRun

DENIED = PermissionError(errno.EACCES, os.strerror(errno.EACCES))
DISK_FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def failing(problem: BaseException | type[BaseException]) -> Callable:
    """A function that raises `problem`, whatever it is given."""

    def fails(*_, **__):
        raise problem

    return fails


def leave_on_disk(free: int, patch: MonkeyPatch) -> None:
    """Let no more than so many bytes be free on any disk."""
    usage = shutil.disk_usage(".")._replace(free=free)
    patch.setattr(shutil, "disk_usage", lambda _: usage)


def find_look_without_work(live: TrainedRun, word: str, refine: bool, **_) -> Look:
    """In place of find_look; fails where a look is to be refined."""
    assert not refine
    return find_look(live, word, refine=False)


def opencv_error(code: int) -> cv2.error:
    """An error of OpenCV with this code of cv2.Error."""
    problem = cv2.error("resize")
    problem.code = code
    return problem
