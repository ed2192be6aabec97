"""Work whose kernels are the same each time, started as one: a CUDA graph.

A GPU is through with a small kernel sooner than the host has started the next.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Generic, TypeVar

import torch

Result = TypeVar("Result")


def can_record(device: torch.device) -> bool:
    """Whether work on this device can be recorded."""
    return device.type == "cuda"


class Recorder:
    """Records on a stream of its own, as CUDA asks for. All recordings work in the same memory: what one leaves there, the next replay overwrites."""

    def __init__(self):
        self.stream = torch.cuda.Stream()
        self.last: torch.cuda.CUDAGraph | None = None

    @contextmanager
    def at_work(self) -> Iterator[None]:
        """All work inside, recorded or not, is on that stream: after what was asked for before, and before what is asked for later."""
        outer = torch.cuda.current_stream()
        self.stream.wait_stream(outer)
        try:
            with torch.cuda.stream(self.stream):
                yield
        finally:
            outer.wait_stream(self.stream)

    def forget(self) -> None:
        """Let the memory of all recordings go with them: none is used any more."""
        self.last = None

    def record(self, work: Callable[[], Result]) -> "Recording[Result]":
        """`work`, which has run before on tensors of the same sizes, so that its kernels are compiled, and waits for nothing. It is not done now."""
        torch.cuda.empty_cache()  # as torch does before: while it records, it gives nothing back that it has reserved
        graph = torch.cuda.CUDAGraph()
        graph.capture_begin(None if self.last is None else self.last.pool())
        try:
            result = work()
        except BaseException:
            with suppress(RuntimeError):  # which would hide the first
                graph.capture_end()
            raise
        graph.capture_end()
        self.last = graph
        return Recording(graph, result)


class Recording(Generic[Result]):
    """Does the work again, on the tensors that it was recorded on; the tensors of `result` then hold what came of it."""

    def __init__(self, graph: torch.cuda.CUDAGraph, result: Result):
        self.graph, self.result = graph, result

    def replay(self) -> Result:
        self.graph.replay()
        return self.result
