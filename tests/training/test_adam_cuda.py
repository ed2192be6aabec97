"""The GPU's Adam against the CPU's; by Triton's interpreter where there is no GPU."""

import pytest
import torch

from core.training.adam import LARGEST_GRADIENT, adam_rows

pytest.importorskip("triton", reason="Triton is not installed")

from core.training import adam_cuda

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


@pytest.mark.parametrize("shape", [(), (3,), (4, 3)], ids=str)
def test_both_agree_and_leave_unseen_rows_alone(shape):
    """On rows of any age, from the first update to those whose corrections are 1."""
    values = torch.randn(900, *shape)
    rows = torch.arange(0, 900, 2)
    ages = torch.tensor([1, 2, 100, 32_000, 2**31 - 1], dtype=torch.int32).repeat(180)
    gradient, rates = torch.randn(len(rows), *shape), torch.rand(values[0].numel())
    gradient[0], gradient[1] = 3e38, -2 * LARGEST_GRADIENT
    start = [values, 0.1 * torch.randn(values.shape), 0.1 * torch.rand(values.shape)]
    expected = [tensor.clone() for tensor in start]
    # The CPU's table of corrections ends with the oldest row.
    adam_rows(*expected, ages.clamp(max=100_000), rows, gradient, rates)
    found = [tensor.clone().to(DEVICE) for tensor in start]
    adam_cuda.adam_rows(*found, ages.to(DEVICE), rows.to(DEVICE), gradient.to(DEVICE), rates)
    for ours, theirs, before in zip(found, expected, start, strict=True):
        torch.testing.assert_close(ours.cpu(), theirs, rtol=1e-6, atol=5e-7)  # of values and steps of order 1, rounded
        assert torch.equal(ours.cpu()[1::2], before[1::2])
