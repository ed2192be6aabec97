"""A stop that waits for the end of the step, so that what was learned can be kept.

Ctrl-C, SIGTERM of a job scheduler, or SIGHUP, when the terminal is closed.
"""

import signal
import threading
from typing import Self

HANG_UP = getattr(signal, "SIGHUP", None)  # Windows has none
STOPS = (signal.SIGINT, signal.SIGTERM) + ((HANG_UP,) if HANG_UP else ())


class StopRequest:
    """Within its `with` block the first of STOPS sets `asked`; the second one interrupts at once, as it would outside.

    SIGHUP never does: a closed terminal sends it twice, by its shell and by the system. Where it is ignored (nohup), it
    stays so.
    """

    def __init__(self):
        self.asked = False
        self._former = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():  # Python takes signal handlers from no other thread
            numbers = [number for number in STOPS if number != HANG_UP or signal.getsignal(number) != signal.SIG_IGN]
            self._former = {number: signal.signal(number, self._ask) for number in numbers}
        return self

    def __exit__(self, *_) -> None:
        for number, handler in self._former.items():
            signal.signal(number, handler)

    def _ask(self, number: int, _) -> None:
        self.asked = True
        for each, handler in self._former.items():
            if HANG_UP not in (number, each):
                signal.signal(each, handler)
