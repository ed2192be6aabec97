"""Ctrl-C that waits for the end of the step, so that what was learned can be kept."""

import signal
import threading
from typing import Self


class StopRequest:
    """Within its `with` block the first Ctrl-C sets `asked`; the second one interrupts at once, as without it."""

    def __init__(self):
        self.asked = False
        self._former = None

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():  # Python takes signal handlers from no other thread
            self._former = signal.signal(signal.SIGINT, self._ask)
        return self

    def __exit__(self, *_) -> None:
        if self._former is not None:
            signal.signal(signal.SIGINT, self._former)

    def _ask(self, *_) -> None:
        self.asked = True
        signal.signal(signal.SIGINT, self._former)
