"""What is recorded on a GPU is done again, with the numbers of the moment."""

from contextlib import nullcontext
from functools import partial

import pytest
import torch

from core.system.cuda_graph import Recorder

on_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU to record anything on")


@on_gpu
def test_recordings_are_replayed_in_turn_with_other_numbers():
    recorder, given = Recorder(), torch.ones(5, device="cuda")
    with recorder.at_work():
        recordings = {factor: recorder.record(partial(torch.mul, given, factor)) for factor in (2, 3)}
        for number in (1.0, 7.0):
            for factor, recording in recordings.items():
                given.fill_(number)
                assert recording.replay().tolist() == [factor * number] * 5


@on_gpu
def test_work_beside_other_work_is_recorded_with_it():
    """It begins after what was there before, and its result is there for what follows."""
    recorder, given = Recorder(), torch.ones(1000, device="cuda")

    def work():
        doubled = given * 2
        later = [recorder.beside(lambda number=number: (doubled + number).cumsum(0)[-1]) for number in range(3)]
        tripled = doubled + given
        return torch.stack([tripled[0], *(finish() for finish in later)])

    with recorder.at_work():
        assert work().tolist() == [3, 2000, 3000, 4000]
        recording = recorder.record(work)
        given.fill_(2.0)
        assert recording.replay().tolist() == [6, 4000, 5000, 6000]


@on_gpu
def test_work_that_fails_while_it_is_recorded_says_why_and_later_work_goes_on():
    """With its memory, and wherever it failed: there was work beside it."""
    recorder, most = Recorder(), 1 << 28

    def fails():
        torch.ones(3, device="cuda").add_(1)
        recorder.beside(lambda: torch.ones(most, dtype=torch.uint8, device="cuda"))
        raise ZeroDivisionError

    torch.cuda.empty_cache()
    before = torch.cuda.memory_reserved()
    with recorder.at_work():
        with pytest.raises(ZeroDivisionError):
            recorder.record(fails)
        assert torch.ones(3, device="cuda").sum().item() == 3
        torch.cuda.empty_cache()
        assert torch.cuda.memory_reserved() < before + most / 2
        assert recorder.record(partial(torch.ones, 3, device="cuda")).replay().sum().item() == 3


def test_streams_beside_come_back_from_work_that_fails_before_its_recording_ends(monkeypatch):
    """By CUDA's rules: what waits for a stream of a recording is in it from then on,
    and has to be waited for before the recording may end."""
    recording, away, ended = set(), set(), []

    class Stream:
        def wait_stream(self, other):
            assert other in recording, "nothing in a recording may wait for what is not"
            away.discard(other)
            if self not in recording:
                recording.add(self)
                away.add(self)

        def record_event(self):
            return None

    class Graph:
        def capture_begin(self, pool):
            recording.add(recorder.stream)

        def capture_end(self):
            ended.append(not away)

    for name, fake in {
        "Stream": Stream,
        "CUDAGraph": Graph,
        "empty_cache": lambda: None,
        "stream": lambda _: nullcontext(),
    }.items():
        monkeypatch.setattr(torch.cuda, name, fake)
    recorder = Recorder()
    monkeypatch.setattr(torch.cuda, "current_stream", lambda: recorder.stream)

    def fails():
        recorder.beside(lambda: None)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        recorder.record(fails)
    assert ended == [True]
