"""Work whose kernels are the same each time, launched as one: a CUDA graph.

A GPU finishes a small kernel before the host has launched the next one, and has room for others beside it.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import cycle
from typing import Generic, TypeVar

import torch

Result = TypeVar("Result")

OTHER_STREAMS = 2


def can_record(device: torch.device) -> bool:
    """Whether work on this device can be recorded."""
    return device.type == "cuda"


class Recorder:
    """Records on a stream of its own, as CUDA asks for.
    All recordings work in the same memory: what one leaves there, the next replay overwrites."""

    def __init__(self):
        self.stream = torch.cuda.Stream()
        self.others = [torch.cuda.Stream() for _ in range(OTHER_STREAMS)]
        self.turns = cycle(self.others)
        self.last: torch.cuda.CUDAGraph | None = None

    @contextmanager
    def at_work(self) -> Iterator[None]:
        """All work inside, recorded or not, is on that stream:
        after what was asked for before, and before what is asked for later."""
        outer = torch.cuda.current_stream()
        self.stream.wait_stream(outer)
        self.turns = cycle(self.others)  # the same streams for the same work: autograd wants to find it where it was
        try:
            with torch.cuda.stream(self.stream):
                yield
        finally:
            outer.wait_stream(self.stream)

    def beside(self, work: Callable[[], Result]) -> Callable[[], Result]:
        """Start the kernels of work() beside those of what follows;
        calling what is returned gives its result, for which what follows then waits.

        Only inside `at_work`. The streams take turns. torch gives memory to another tensor of the stream that it was
        taken on, whoever else still reads it: so the caller keeps what the work reads until it has the result, and the
        result to the end of the step.
        """
        stream = next(self.turns)
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            result = work()
            done = stream.record_event()

        def finish() -> Result:
            torch.cuda.current_stream().wait_event(done)
            return result

        return finish

    def forget(self) -> None:
        """Let the memory of all recordings go with them: none is used any more."""
        self.last = None

    def record(self, work: Callable[[], Result]) -> "Recording[Result]":
        """`work`, which has run before on tensors of the same sizes, so that its kernels are compiled,
        and waits for nothing. It is not done now."""
        torch.cuda.empty_cache()  # as torch does before: while it records, it gives nothing back that it has reserved
        graph = torch.cuda.CUDAGraph()
        graph.capture_begin(None if self.last is None else self.last.pool())
        try:
            result = work()
        except BaseException:
            self._abandon(graph)
            raise
        graph.capture_end()
        self.last = graph
        return Recording(graph, result)

    def _abandon(self, graph: torch.cuda.CUDAGraph) -> None:
        """End a recording whose work failed. While a stream beside is still in it, CUDA refuses,
        and torch would never give its memory back. Nor does torch up to 2.13 where CUDA itself has broken off the
        recording (pytorch/pytorch#190348)."""
        with suppress(RuntimeError):  # which would hide why the work failed
            for other in self.others:
                # Now it is in the recording, if it was not before; else nothing could wait for it.
                other.wait_stream(self.stream)
                self.stream.wait_stream(other)
        with suppress(RuntimeError):
            graph.capture_end()


class Recording(Generic[Result]):
    """Does the work again, on the tensors that it was recorded on;
    the tensors of `result` then hold what came of it."""

    def __init__(self, graph: torch.cuda.CUDAGraph, result: Result):
        self.graph, self.result = graph, result

    def replay(self) -> Result:
        self.graph.replay()
        return self.result
