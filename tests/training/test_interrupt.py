"""Ctrl-C and SIGTERM: the step is finished first."""

import signal

import pytest

from core.training.interrupt import STOPS, StopRequest


@pytest.mark.parametrize("number", STOPS)
def test_the_first_signal_asks_and_the_second_does_what_it_always_did(number):
    heard = []
    former = {each: signal.signal(each, lambda *_: heard.append("former")) for each in STOPS}
    try:
        with StopRequest() as stop:
            assert not stop.asked
            signal.raise_signal(number)
            assert stop.asked and heard == []
            signal.raise_signal(number)
            assert heard == ["former"]
        with StopRequest():
            pass
        signal.raise_signal(number)
        assert heard == ["former", "former"]
    finally:
        for each, handler in former.items():
            signal.signal(each, handler)
