"""What Ctrl-C, SIGTERM (from job schedulers and `kill`) and SIGHUP (from a closed terminal) do to the program."""

import os
import signal
from types import FrameType

from core.training.interrupt import HANG_UP, STOPS
from wegs_cli import INTERRUPTED
from wegs_cli.main import say_last


def end_at_once() -> None:
    """Until `work_begins`, a stop ends the program where it is: there is nothing yet to remove or to keep.
    A KeyboardInterrupt while torch is loaded may be swallowed, or end the program with pages of C++ addresses."""
    for number in STOPS:
        # Shells have background jobs ignore Ctrl-C, and nohup a closed terminal.
        if number == signal.SIGTERM or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _end)


def work_begins() -> None:
    """From now on a stop is a KeyboardInterrupt: half-written files and folders are removed, a training is kept."""
    for number in STOPS:
        if signal.getsignal(number) is _end:
            signal.signal(number, _hang_up if number == HANG_UP else signal.default_int_handler)


def ignore_stops() -> None:
    """Ignore further signals while the last line is printed: a second Ctrl-C would put a traceback in its place."""
    for number in STOPS:
        signal.signal(number, signal.SIG_IGN)


def _end(_number: int, _frame: FrameType | None) -> None:
    ignore_stops()
    try:
        say_last("Stopped.")
    finally:
        os._exit(INTERRUPTED)


def _hang_up(number: int, frame: FrameType | None) -> None:
    """Treat a closed terminal as a single Ctrl-C, although its shell and the system both send the signal."""
    signal.signal(number, signal.SIG_IGN)
    signal.default_int_handler(number, frame)
