"""What a GPU gathers for density control equals its definition; by Triton's interpreter where there is no GPU."""

import pytest
import torch

from core.training.gaussians.densify import plain_gather
from core.training.gaussians.gaussians import Gaussians

pytest.importorskip("triton", reason="Triton is not installed")

from core.training.gaussians import density_statistics_cuda

DEVICE = torch.device("cuda" if torch.cuda.is_available() else "cpu")


def gathered(gather, device: torch.device, count: int, taken: bool) -> list[torch.Tensor]:
    """Both statistics after two views of the first `count` of every other of 300 Gaussians, 50 of them sky;
    pulls are NaN if not taken."""
    generator = torch.Generator().manual_seed(0)
    gaussians = Gaussians.of({"means": torch.zeros(300, 3)}, sky_count=50).to(device)
    gaussians.gradient_sum += 1
    rows = torch.arange(0, 300, 2, device=device)[:count]
    for _ in range(2):
        pulls = torch.randn(count, 2, generator=generator) * (1 if taken else torch.nan)
        gather(
            gaussians,
            rows,
            pulls.to(device),
            torch.tensor([15.5, 10.0], device=device),
            torch.tensor(taken, device=device),
        )
    return [gaussians.gradient_sum.cpu(), gaussians.seen.cpu()]


def test_rows_of_minus_one_are_skipped():
    gaussians = Gaussians.of({"means": torch.zeros(5, 3)}, sky_count=0).to(DEVICE)
    rows, one = torch.tensor([1, 4, -1, -1], device=DEVICE), torch.ones(2, device=DEVICE)
    density_statistics_cuda.gather(
        gaussians, rows, torch.ones(4, 2, device=DEVICE), one, torch.tensor(True, device=DEVICE)
    )
    assert gaussians.seen.tolist() == [0, 1, 0, 0, 1] and (gaussians.gradient_sum > 0).tolist() == [
        False,
        True,
        False,
        False,
        True,
    ]


@pytest.mark.parametrize("taken", [True, False], ids=["taken", "not-taken"])
@pytest.mark.parametrize("count", [0, 128, 150], ids=lambda count: f"{count}-rows")  # a program has 128
def test_the_kernel_equals_the_definition(count, taken):
    found = gathered(density_statistics_cuda.gather, DEVICE, count, taken)
    torch.testing.assert_close(found, gathered(plain_gather, torch.device("cpu"), count, taken), rtol=1e-6, atol=0)
    assert bool(found[1].any()) == (taken and count > 0)
