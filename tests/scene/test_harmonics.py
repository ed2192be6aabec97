"""The SH basis: an orthonormal one, with the signs that every 3DGS viewer expects."""

import math

import numpy as np
import pytest
import torch
from numpy.polynomial import Legendre

from core.errors import BadSetting
from core.scene.harmonics import MAX_DEGREE, SH_0, basis, coefficient_count, colour, dc_of_colour, degree_of


def directions_and_weights(order: int) -> tuple[torch.Tensor, torch.Tensor]:
    """A quadrature on the sphere, exact for polynomials of degree 2 * order - 1: Gauss in z, even steps around."""
    z, z_weights = np.polynomial.legendre.leggauss(order)
    angle = 2 * math.pi * np.arange(2 * order) / (2 * order)
    ring = np.sqrt(1 - z**2)[:, None]
    points = np.stack(
        [ring * np.cos(angle), ring * np.sin(angle), np.broadcast_to(z[:, None], (order, 2 * order))], axis=-1
    )
    weights = np.broadcast_to(z_weights[:, None] * math.pi / order, (order, 2 * order))
    return torch.from_numpy(points.reshape(-1, 3)), torch.from_numpy(weights.reshape(-1).copy())


def test_basis_is_orthonormal():
    directions, weights = directions_and_weights(8)
    values = basis(directions, MAX_DEGREE)
    products = torch.einsum("pi,pj,p->ij", values, values, weights)
    # float64 sums of 128 terms; the constants have 16 digits.
    torch.testing.assert_close(products, torch.eye(16, dtype=torch.float64), rtol=0, atol=1e-12)


def real_harmonic(band: int, order: int, direction: np.ndarray) -> float:
    """Y_band,order from its textbook definition, with the Condon-Shortley phase (-1)^order, as in the original 3DGS."""
    x, y, z = direction
    around = math.atan2(y, x)
    steps = abs(order)
    legendre = (-1) ** steps * math.sqrt(1 - z * z) ** steps * Legendre.basis(band).deriv(steps)(z)
    norm = math.sqrt((2 * band + 1) / (4 * math.pi) * math.factorial(band - steps) / math.factorial(band + steps))
    if order == 0:
        return norm * legendre
    return math.sqrt(2) * norm * legendre * (math.sin(steps * around) if order < 0 else math.cos(steps * around))


@pytest.mark.parametrize("direction", [(0.48, -0.6, 0.64), (-0.8, 0.36, -0.48), (0.36, 0.48, 0.8)])
def test_order_and_signs_are_those_of_viewers(direction):
    """One swapped or flipped coefficient shows wrong colours in every viewer, and in none of our own pictures."""
    expected = [real_harmonic(band, order, direction) for band in range(4) for order in range(-band, band + 1)]
    values = basis(torch.tensor([direction], dtype=torch.float64), 3)[0]
    np.testing.assert_allclose(values.numpy(), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("degree", range(MAX_DEGREE + 1))
def test_lower_degrees_are_the_first_columns(degree):
    directions = torch.nn.functional.normalize(torch.randn(20, 3), dim=1)
    assert torch.equal(basis(directions, degree), basis(directions, 3)[:, : coefficient_count(degree)])
    assert degree_of(coefficient_count(degree)) == degree


def test_zero_direction_shows_the_dc_colour_only_up_to_degree_1():
    sh = torch.randn(5, 4, 3)
    sh[:, 0] = dc_of_colour(torch.full((5, 3), 0.7))
    torch.testing.assert_close(colour(sh, torch.zeros(5, 3)), torch.full((5, 3), 0.7))


def test_dc_of_colour_is_seen_from_every_side():
    colours = torch.rand(30, 3)
    directions = torch.nn.functional.normalize(torch.randn(30, 3), dim=1)
    # One multiplication and one division in float32.
    torch.testing.assert_close(colour(dc_of_colour(colours)[:, None, :], directions), colours, rtol=0, atol=2e-7)


def test_colour_is_clamped_at_black_not_at_white():
    sh = torch.tensor([[[-10.0, 10.0, 0.0]]], requires_grad=True)
    shown = colour(sh, torch.tensor([[0.0, 0.0, 1.0]]))
    assert shown[0].tolist() == pytest.approx([0.0, 0.5 + 10 * SH_0, 0.5])
    shown.sum().backward()
    assert sh.grad[0, 0].tolist() == pytest.approx([0.0, SH_0, SH_0])


@pytest.mark.parametrize("degree", [-1, 4])
def test_unknown_degree(degree):
    with pytest.raises(BadSetting, match="degree"):
        coefficient_count(degree)


@pytest.mark.parametrize("coefficients", [0, 2, 15, 25])
def test_coefficients_of_no_degree(coefficients):
    with pytest.raises(BadSetting, match=f"{coefficients} SH coefficients"):
        degree_of(coefficients)
