"""Imports pycolmap for the first time, with signals deferred: a Ctrl-C during the import would be reported as a broken
installation. The handler that pycolmap sets for SIGTERM, which would print pages of C++ addresses, is replaced by the
previous one. (For a tenth of a second in between, SIGTERM gets through.)
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

# Before pycolmap: loaded after it, OpenCV corrupts memory when it writes a PNG (OpenCV 5.0.0, pycolmap 4.2.1).
import cv2  # noqa: F401

STOPS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def _signals_deferred() -> Iterator[None]:
    """Signals are delivered at the end of the block, to the handlers that were set before it."""
    arrived: list[int] = []
    former = {stop: signal.signal(stop, lambda number, _: arrived.append(number)) for stop in STOPS}
    try:
        yield
    finally:
        for stop, handler in former.items():
            signal.signal(stop, handler or signal.SIG_DFL)
    for number in arrived:
        signal.raise_signal(number)


# Python can set handlers in the main thread only.
with _signals_deferred() if threading.current_thread() is threading.main_thread() else nullcontext():
    import pycolmap  # noqa: F401
