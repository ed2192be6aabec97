"""What holds for every test: two threads, as on the smallest machine that is supported, and the same random numbers."""

import os

import pytest

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does, before torch is imported

import torch


@pytest.fixture(autouse=True)
def same_conditions():
    torch.set_num_threads(2)
    torch.manual_seed(0)
