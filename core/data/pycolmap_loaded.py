"""Loads pycolmap for the first time: a Ctrl-C meanwhile would end in words about a broken installation, and SIGTERM, from then on, in pages of
C++ addresses. Both wait until it is loaded, and then do what they did before. (For a tenth of a second, once pycolmap has set its handler, SIGTERM
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
