"""How a script begins, before it imports what takes seconds to load."""

import sys
from types import TracebackType

from core.system.process import prepare


def begin() -> None:
    """Set up the process before torch is imported.
    Until the script's command runs, which answers Ctrl-C itself, Ctrl-C ends it without a word."""
    prepare()
    sys.excepthook = _tell


def _tell(kind: type[BaseException], problem: BaseException, traceback: TracebackType | None) -> None:
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, problem, traceback)
