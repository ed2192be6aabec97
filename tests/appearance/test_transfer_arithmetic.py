"""The SH transfer's kernels against the formulas that they stand for, in float64."""

import re

import numba
import numpy as np
import pytest
import torch

from core.appearance.positional_encoding import contract, encode, encoded_size
from core.appearance.transfer_arithmetic import bound_softly, encode_positions
from tests.afresh import afresh, assembly_of

EPS = float(np.finfo(np.float32).eps)
BLOCK = numba.float32[:, ::1]
NOTHING = np.empty(0, np.float32)


@pytest.mark.parametrize("bound", [0.1, 4.0])
def test_bound_is_a_scaled_tanh(bound):
    """From denormals to values far beyond saturation, dense where the fit has its ripples."""
    small, ripples = np.logspace(-44, 0, 500), np.linspace(0, 12, 20_001)
    values = np.concatenate([small, ripples, [1e4, np.finfo(np.float32).max * 0.01]])
    values = (np.concatenate([values, -values]) * bound).astype(np.float32)
    expected = bound * np.tanh(values.astype(np.float64) / np.float32(bound))
    found = np.empty_like(values)
    afresh(bound_softly)(values, np.float32(bound), NOTHING, found)
    # A dozen roundings, each of half an eps at most; they seldom add up.
    assert np.allclose(found, expected, rtol=4 * EPS, atol=1e-44)
    assert np.abs(found).max() <= np.float32(bound)


def test_the_bound_keeps_nan_and_limits_infinity():
    values = np.array([np.nan, np.inf, -np.inf, 0.0], np.float32)
    found = np.empty_like(values)
    afresh(bound_softly)(values, np.float32(4), NOTHING, found)
    assert np.allclose(found, [np.nan, 4, -4, 0], rtol=EPS, atol=0, equal_nan=True)  # the rounding of the quotient


def test_bound_is_added_to_what_is_given():
    """As the live look adds its residual: bit for bit, whatever the bound."""
    values, base = np.linspace(-3, 3, 777, dtype=np.float32), np.linspace(5, -5, 777, dtype=np.float32)
    for bound in (0.3, 2):
        found, residual = np.empty_like(values), np.empty_like(values)
        afresh(bound_softly)(values, np.float32(bound), base, found)
        afresh(bound_softly)(values, np.float32(bound), NOTHING, residual)
        assert np.array_equal(found, base + residual)


@pytest.mark.parametrize("octaves", [0, 1, 4, 7])
def test_places_are_contracted_and_encoded(octaves):
    """Inside and outside the unit ball, at its centre and very far; the rest of the block is zero."""
    generator = torch.Generator().manual_seed(octaves)
    directions = torch.nn.functional.normalize(torch.randn(60, 3, generator=generator), dim=1)
    means = directions * torch.cat([torch.zeros(1), torch.logspace(-3, 15, 59)])[:, None]
    encoded = np.full((encoded_size(3, octaves), 64), 7, np.float32)
    afresh(encode_positions)(means.numpy(), octaves, encoded)
    expected = encode(contract(means.double()), octaves).numpy().T
    # A rounded sine or cosine, whose error each octave doubles on average; pi as for `encode` itself.
    assert np.allclose(encoded[:, :60], expected, rtol=0, atol=np.pi * 2**octaves * EPS)
    assert not encoded[:, 60:].any()


LINE = numba.float32[::1]
LOOPS = {bound_softly: (LINE, numba.float32, LINE, LINE), encode_positions: (BLOCK, numba.int64, BLOCK)}


@pytest.mark.parametrize(
    "part, instruction", [(bound_softly, r"vdivps\s.*[yz]mm"), (encode_positions, r"vfn?m\w+pd\s.*[yz]mm")]
)
def test_loops_are_vectorised(part, instruction):
    assert re.search(instruction, assembly_of(part, LOOPS[part]))
