"""What holds for every test: two threads, as on the smallest machine that is supported, and the same random numbers.

Without a GPU the CUDA kernels run by Triton's interpreter, on the CPU.
"""

import os
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
