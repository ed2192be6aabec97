"""Kernels compiled in two processes: every kernel of a step in one of them, and no process where none is needed."""

import subprocess
from unittest.mock import Mock

import pytest
import torch
from numba import njit

from core.training import compiling
from tests.failing import failing
from tests.programs import run_python

LEARNED_THEN_STEPPED = """
import sys

from core.training.compiling import learn_look, learn_picture
from numba.core.dispatcher import Dispatcher
from samples.measurements.steps import EVERYTHING, trainer_of


def known():
    modules = [module for name, module in sys.modules.items() if name.startswith("core.")]
    named = {(value.__module__, name): value for module in modules for name, value in vars(module).items()
             if isinstance(value, Dispatcher)}
    return {(*name, signature) for name, kernel in named.items() for signature in kernel.signatures}


learn_picture()
learn_look()
before = known()
trainer_of(0.1, EVERYTHING).step()
print(*sorted(name for _, name, _ in known() - before))
"""
LEFT = "_count _gather _update"  # a second of work: of the Gaussians' Adam and of density control


def test_a_step_finds_its_kernels():
    """In a process of its own, as others of these tests have compiled everything."""
    assert run_python(LEARNED_THEN_STEPPED).stdout.strip() == LEFT


def test_the_other_process_learns_a_look():
    assert compiling._learning_elsewhere().wait() == 0


class Other:
    """Stands for the other process."""

    started, awaited = 0, 0

    def __call__(self):
        self.started += 1
        return self

    def wait(self, timeout):
        self.awaited += 1
        raise subprocess.TimeoutExpired("python", timeout)  # which is none of the user's business


@pytest.fixture
def other(monkeypatch):
    """Learning from a picture compiles two kernels; there are two threads, and there is memory."""
    compiled = [njit(lambda x: x / 2), njit(lambda x: x / 3)]
    monkeypatch.setattr(compiling, "learn_picture", lambda: [kernel(6.0) for kernel in compiled])
    monkeypatch.setattr(compiling, "learn_look", lambda: None)
    monkeypatch.setattr(compiling, "threads", lambda: 2)
    monkeypatch.setattr(compiling.memory, "room", lambda: None)
    other = Other()
    monkeypatch.setattr(compiling, "_learning_elsewhere", other)
    return other


def test_the_other_process_is_started_once_and_awaited_where_kernels_are_compiled(other):
    compiling.compile_kernels(looks=True)
    assert (other.started, other.awaited) == (1, 1)
    compiling.compile_kernels(looks=True)  # now they are known
    assert (other.started, other.awaited) == (1, 1)


def test_one_thread_compiles_alone(other, monkeypatch):
    monkeypatch.setattr(compiling, "threads", lambda: 1)
    compiling.compile_kernels(looks=True)
    assert not other.started


def test_there_is_no_second_process_without_memory_for_it(other, monkeypatch):
    monkeypatch.setattr(compiling.memory, "room", lambda: 2 << 30)
    compiling.compile_kernels(looks=True)
    assert not other.started


def test_a_process_that_cannot_be_started_is_done_without(other, monkeypatch):
    refused = Mock(side_effect=OSError("no more processes"))
    monkeypatch.setattr(compiling, "_learning_elsewhere", refused)
    compiling.compile_kernels(looks=True)
    assert refused.called


def test_nothing_is_compiled_for_looks_that_a_run_does_not_have(other, monkeypatch):
    monkeypatch.setattr(compiling, "learn_look", failing(AssertionError()))
    compiling.compile_kernels(looks=False)
    assert not other.started


def test_learning_draws_no_random_numbers_of_the_training(monkeypatch):
    monkeypatch.setattr(compiling, "threads", lambda: 1)
    before = torch.get_rng_state()
    compiling.compile_kernels(looks=True)
    assert torch.equal(before, torch.get_rng_state())
