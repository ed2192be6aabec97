"""What holds for every test: two threads, as on the smallest machine that is supported, and the same random numbers."""

import pytest
import torch


@pytest.fixture(autouse=True)
def same_conditions():
    torch.set_num_threads(2)
    torch.manual_seed(0)
