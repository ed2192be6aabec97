"""The exposure map on coefficients against the affine map on colours."""

import torch

from core.appearance.exposure import ExposureTransfer
from core.appearance.sh_transfer import TransferInput
from core.scene.harmonics import basis, degree_of
from tests.small import whole_settings


def test_the_map_is_the_identity_before_training():
    transfer = ExposureTransfer(whole_settings())
    residual = transfer(TransferInput(torch.randn(9, 4, 3), torch.randn(9, 3)), torch.randn(16))
    assert not residual.any()


def colours_of(sh: torch.Tensor, directions: torch.Tensor) -> torch.Tensor:
    """Colours before the clamp at 0."""
    return torch.einsum("nc,nck->nk", basis(directions, degree_of(sh.shape[1])), sh) + 0.5


def test_coefficients_are_mapped_as_colours_are():
    transfer = ExposureTransfer(whole_settings(embedding_size=4)).double()
    torch.nn.init.normal_(transfer.map.weight)
    torch.nn.init.normal_(transfer.map.bias)
    for degree in range(4):
        sh = torch.randn(20, (degree + 1) ** 2, 3, dtype=torch.float64)
        embedding = torch.randn(4, dtype=torch.float64)
        directions = torch.nn.functional.normalize(torch.randn(20, 3, dtype=torch.float64), dim=1)
        change, offset = transfer.change(embedding)
        expected = colours_of(sh, directions) @ (change + torch.eye(3)).T + offset
        mapped = sh + transfer(TransferInput(sh, torch.zeros(20, 3, dtype=torch.float64)), embedding)
        found = colours_of(mapped, directions)
        assert torch.allclose(found, expected, rtol=1e-12, atol=1e-12)  # float64 roundings


def test_gradients_reach_map_embedding_and_sh():
    for detach in (False, True):
        transfer = ExposureTransfer(whole_settings(detach_sh=detach))
        torch.nn.init.normal_(transfer.map.weight)
        sh, embedding = torch.randn(5, 4, 3).requires_grad_(), torch.randn(16).requires_grad_()
        transfer(TransferInput(sh, torch.zeros(5, 3)), embedding).sum().backward()
        assert embedding.grad.any() and transfer.map.weight.grad.any()
        assert (sh.grad is None) == detach
