"""A stop that waits for the end of the step, so that what was learned can be kept: Ctrl-C, or SIGTERM of a job scheduler."""

import signal
import threading
from typing import Self

STOPS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Within its `with` block the first Ctrl-C or SIGTERM sets `asked`; the second one interrupts at once, as without it."""

    def __init__(self):
        self.asked = False
        self._former = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():  # Python takes signal handlers from no other thread
            self._former = {number: signal.signal(number, self._ask) for number in STOPS}
        return self

    def __exit__(self, *_) -> None:
        for number, handler in self._former.items():
            signal.signal(number, handler)

    def _ask(self, *_) -> None:
        self.asked = True
        self.__exit__()
