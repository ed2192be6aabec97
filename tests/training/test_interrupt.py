"""Ctrl-C, SIGTERM and SIGHUP: the step is finished first."""

import signal

import pytest

from core.training.interrupt import HANG_UP, STOPS, StopRequest


@pytest.mark.parametrize("number", [number for number in STOPS if number != HANG_UP])
def test_the_first_signal_asks_to_stop_and_the_second_has_its_usual_effect(number):
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


@pytest.mark.skipif(HANG_UP is None, reason="Windows has no SIGHUP")
def test_hang_ups_only_ask_to_stop_and_are_ignored_under_nohup():
    heard = []
    former = {each: signal.signal(each, lambda *_: heard.append("former")) for each in STOPS}
    try:
        with StopRequest() as stop:
            signal.raise_signal(HANG_UP)
            signal.raise_signal(HANG_UP)  # by the shell, and by the system
            assert stop.asked
        with StopRequest():
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(HANG_UP)
        assert heard == []
        signal.signal(HANG_UP, signal.SIG_IGN)
        with StopRequest() as stop:
            signal.raise_signal(HANG_UP)
            assert not stop.asked
    finally:
        for each, handler in former.items():
            signal.signal(each, handler)
