"""The GPU's L_regSH equals its definition; by Triton's interpreter where there is no GPU."""

import pytest
import torch

from core.training.losses.regularisers import plain_residual_loss

pytest.importorskip("triton", reason="Triton is not installed")

from core.training.losses import residual_cuda

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


def example(count: int, coefficients: int) -> torch.Tensor:
    """Residuals of usual size, every third zero."""
    residual = 0.1 * torch.randn(count, coefficients, 3, generator=torch.Generator().manual_seed(0))
    residual[::3] = 0
    return residual


@pytest.mark.parametrize("count", [0, 1, 16, 100])  # a program has 16
@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_the_kernel_equals_the_definition(count, coefficients):
    residual = example(count, coefficients)
    loss, gradient, size = (part.cpu().double() for part in residual_cuda.residual_loss(residual.to(DEVICE), 0.3))
    expected = plain_residual_loss(residual.double(), 0.3)
    torch.testing.assert_close((loss, gradient, size), expected, rtol=1e-6, atol=1e-9)


def test_rows_that_are_no_gaussians_do_not_count():
    residual, shown = example(100, 4), torch.tensor(37, device=DEVICE)
    loss, gradient, size = (
        part.cpu().double() for part in residual_cuda.residual_loss(residual.to(DEVICE), 0.3, shown)
    )
    expected_loss, expected_gradient, expected_size = plain_residual_loss(residual[:37].double(), 0.3)
    torch.testing.assert_close(
        (loss, gradient[:37], size), (expected_loss, expected_gradient, expected_size), rtol=1e-6, atol=1e-9
    )
    assert not gradient[37:].any()


def test_nan_in_a_residual_reaches_loss_and_gradient():
    """The step is then refused."""
    residual = example(40, 4)
    residual[20, 1, 2] = torch.nan
    assert all(part.isnan().any() for part in residual_cuda.residual_loss(residual.to(DEVICE), 0.3))
