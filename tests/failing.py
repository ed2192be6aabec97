"""What fails in a test in place of what hardly ever fails:
a full disk, or a file that may not be read. (Root may read any.)"""

import errno
import os
import shutil
from collections.abc import Callable

import cv2
from pytest import MonkeyPatch

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


def opencv_error(code: int) -> cv2.error:
    """An error of OpenCV with this code of cv2.Error."""
    problem = cv2.error("resize")
    problem.code = code
    return problem
