"""Loads pycolmap for the first time, while signals wait. A Ctrl-C during the import would be reported as a broken installation; and the handler
that pycolmap sets for SIGTERM would print pages of C++ addresses, so the one from before is put back. (For a tenth of a second in between, SIGTERM
gets through.)
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import cv2  # noqa: F401 - before pycolmap: loaded after it, OpenCV corrupts memory when it writes a PNG (OpenCV 5.0.0, pycolmap 4.2.1)

STOPS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def _later() -> Iterator[None]:
    """Signals wait until the end of the block, and meet the handlers that were there before it."""
    arrived = []
    former = {number: signal.signal(number, lambda number, _: arrived.append(number)) for number in STOPS}
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler or signal.SIG_DFL)
    for number in arrived:
        signal.raise_signal(number)


# Python sets handlers in no other thread.
with _later() if threading.current_thread() is threading.main_thread() else nullcontext():
    import pycolmap  # noqa: F401
