"""The matrix product of the SH transfer's kernels, and what the compiler makes of them.
Values and gradients: test_sh_transfer."""

import re

import numpy as np
import pytest
import torch

from core.appearance.matrix_product import ANY, ZERO, has_avx512, multiply
from core.appearance.sh_transfer import SHTransfer, TransferInput
from core.appearance.transfer_kernels import hidden_backward, mlp_forward, output_backward
from tests.afresh import afresh, assembly_of
from tests.small import whole_settings

multiplied = afresh(multiply)


def product(left, right, start, least, transpose=False):
    into = np.empty((left.shape[1] if transpose else left.shape[0], right.shape[1]), np.float32)
    multiplied(left, transpose, right, start, into, np.float32(least))
    return into


@pytest.mark.parametrize("rows, columns, inner", [(8, 16, 1), (16, 48, 27), (24, 32, 0), (128, 16, 33), (8, 80, 5)])
def test_the_matrix_product_is_exact_on_small_integers(rows, columns, inner):
    """Small integers: sums are exact in any order."""
    random = np.random.default_rng(rows)
    sizes = (rows, inner), (inner, columns), (rows, columns), (1, columns)
    left, right, start, bias = (random.integers(-4, 5, size).astype(np.float32) for size in sizes)
    np.testing.assert_array_equal(product(left, right, bias, ANY), left @ right + bias)
    np.testing.assert_array_equal(product(left, right, start, ZERO), np.maximum(left @ right + start, 0))
    transposed = np.ascontiguousarray(left.T)
    np.testing.assert_array_equal(product(transposed, right, start, ANY, transpose=True), left @ right + start)
    sums = start.copy()
    multiplied(transposed, True, right, sums, sums, ANY)
    np.testing.assert_array_equal(sums, left @ right + start)


def test_a_relu_keeps_nan():
    left = np.ones((8, 2), np.float32)
    left[1, 0] = np.nan
    result = product(left, -np.ones((2, 16), np.float32), np.zeros((1, 16), np.float32), ZERO)
    assert np.isnan(result[1]).all() and (np.delete(result, 1, axis=0) == 0).all()


@pytest.mark.parametrize("kernel", [mlp_forward, output_backward, hidden_backward], ids=["forward", "output", "hidden"])
def test_kernels_use_wide_registers(kernel):
    transfer = SHTransfer(whole_settings(sh_degree=1))
    transfer(TransferInput(torch.zeros(2, 4, 3), torch.zeros(2, 3)), torch.zeros(16)).sum().backward()
    assembly = assembly_of(kernel, kernel.signatures[0])
    register = "zmm" if has_avx512() else "ymm"
    assert len(re.findall(rf"vfmadd\d+ps\s.*%{register}", assembly)) >= 8
