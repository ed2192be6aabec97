"""The positional encoding against its formula, and the contraction against mip-NeRF 360's."""

from math import pi

import pytest
import torch

from core.appearance.positional_encoding import contract, encode, encoded_size


@pytest.mark.parametrize("octaves", [0, 1, 2, 4, 7])
def test_encode_is_the_formula(octaves):
    values = torch.rand(50, 3, dtype=torch.float64, generator=torch.manual_seed(0)) * 2 - 1
    direct = [values]
    for octave in range(octaves):
        direct += [torch.sin(2**octave * pi * values), torch.cos(2**octave * pi * values)]
    direct = torch.cat(direct, dim=1)
    assert direct.shape[1] == encoded_size(3, octaves)
    # An angle of pi is off by half a unit in the last place, and each octave doubles what is off.
    eps = 2**octaves * pi
    assert torch.allclose(encode(values, octaves), direct, rtol=0, atol=eps * torch.finfo(torch.float64).eps)
    single = encode(values.float(), octaves).double()
    assert torch.allclose(single, direct, rtol=0, atol=eps * torch.finfo(torch.float32).eps)


def test_contract_is_half_of_mip_nerf_360s():
    directions = torch.nn.functional.normalize(torch.randn(40, 3, dtype=torch.float64), dim=1)
    radii = torch.logspace(-3, 6, 40, dtype=torch.float64)[:, None]
    expected = torch.where(radii <= 1, radii, 2 - 1 / radii) / 2 * directions
    assert torch.allclose(contract(directions * radii), expected, rtol=1e-13, atol=0)  # a few roundings


def test_contract_keeps_everything_in_range():
    means = torch.tensor([[0.0, 0.0, 0.0], [1e6, -1e6, 1e6], [1e15, 0.0, 0.0], [1.0, 0.0, 0.0]])
    contracted = contract(means)
    assert contracted.abs().max() <= 1
    assert contracted[3, 0] == 0.5  # the unit ball's surface: both branches meet
    assert contracted[2, 0] == 1.0


def test_the_kernel_of_a_gpu_encodes_the_same_places():
    """By Triton's interpreter where there is no GPU."""
    pytest.importorskip("triton", reason="Triton is not installed")
    from core.appearance import positional_encoding_cuda

    device = "cuda" if torch.cuda.is_available() else "cpu"
    means = torch.randn(1200, 3) * torch.logspace(-3, 3, 1200)[:, None]
    means[0] = 0
    found = positional_encoding_cuda.encoded_positions(means.to(device), 4).cpu().double()
    # Rounding of the angle and its sine, doubled by each octave.
    assert torch.allclose(
        found, encode(contract(means.double()), 4), rtol=0, atol=2**4 * 8 * torch.finfo(torch.float32).eps
    )
