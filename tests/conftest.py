"""What holds for every test: two threads, as on the smallest machine that is supported, and the same random numbers,
and no network.

Without a GPU the CUDA kernels run by Triton's interpreter, on the CPU.
"""

import os
import socket
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec

import pytest

from core.system.process import prepare

prepare()  # before torch is imported

import torch

if not torch.cuda.is_available():
    os.environ.setdefault("TRITON_INTERPRET", "1")  # read once, when Triton is imported
    if find_spec("triton"):
        from tests import interpreter

        interpreter.hasten()


@pytest.fixture(autouse=True, scope="session")
def no_network():
    """wegs downloads nothing. Only processes of this machine may be reached, as multiprocessing does."""

    def checked(connect):
        def connected(self, address):
            assert self.family == getattr(socket, "AF_UNIX", None), f"a connection to {address}"
            return connect(self, address)

        return connected

    def looked_up(host, *_, **__):
        raise AssertionError(f"the address of {host} was asked for")

    with pytest.MonkeyPatch.context() as patch:
        for name in ("connect", "connect_ex"):
            patch.setattr(socket.socket, name, checked(getattr(socket.socket, name)))
        patch.setattr(socket, "getaddrinfo", looked_up)
        yield


@pytest.fixture(autouse=True)
def same_conditions():
    torch.set_num_threads(2)
    torch.manual_seed(0)
    yield
    torch.set_num_threads(2)  # before fixtures of the next module, too


@pytest.fixture
def few_steps(monkeypatch):
    """Where it does not matter how far a refinement comes."""
    monkeypatch.setattr("core.appearance.refinement.STEPS", 8)
    monkeypatch.setattr("core.appearance.refinement.LATER_STEPS", 4)


@pytest.fixture
def many_threads(monkeypatch):
    """Five threads beside the caller's, however few cores there are."""
    with ThreadPoolExecutor(5) as pool:
        monkeypatch.setattr("core.system.threads._pool", lambda: pool)
        yield


@pytest.fixture
def on_threads(many_threads):
    """A function of some numbers of threads and of work: what work() gives on each of them."""

    def results(numbers, work):
        found = []
        for number in numbers:
            torch.set_num_threads(number)
            found.append(work())
            assert torch.get_num_threads() == number
        return found

    return results
