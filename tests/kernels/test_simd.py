"""The vectors: each operation against NumPy."""

import numpy as np
import pytest
from numba import njit

from core.kernels import simd


@njit
def arithmetic(a, b, results):
    x, y = simd.load(a, 1), simd.load(b, 1)
    simd.store(results[0], 0, x + y)
    simd.store(results[1], 0, x - y)
    simd.store(results[2], 0, x * y)
    simd.store(results[3], 0, x / y)
    simd.store(results[4], 0, simd.minimum(x, y))
    simd.store(results[5], 0, simd.maximum(x, y))
    simd.store(results[6], 0, simd.select(x >= y, x, simd.broadcast(a[0])))
    return simd.bits(x >= y), simd.lane_sum(x), simd.lane_maximum(x)


def test_arithmetic():
    random = np.random.default_rng(0)
    a, b = random.normal(size=(2, 9)).astype(np.float32)
    results = np.empty((7, 8), dtype=np.float32)
    bits, total, largest = arithmetic(a, b, results)
    x, y = a[1:], b[1:]  # off by one element: loads need no alignment
    expected = [x + y, x - y, x * y, x / y, np.minimum(x, y), np.maximum(x, y)]
    expected.append(np.where(x >= y, x, a[0]))
    np.testing.assert_array_equal(results, np.stack(expected))
    assert bits == sum(1 << int(lane) for lane in np.flatnonzero(x >= y))
    assert largest == x.max()
    assert total == pytest.approx(x.sum(dtype=np.float64), abs=8 * 2**-23)  # eight roundings of numbers of order 1


@njit
def summed(rows, sums):
    total = simd.lane_sums(
        simd.load(rows, 0), simd.load(rows, 8), simd.load(rows, 16), simd.load(rows, 24),
        simd.load(rows, 32), simd.load(rows, 40), simd.load(rows, 48), simd.load(rows, 56),
    )  # fmt: skip
    simd.store(sums, 0, total)


def test_lane_sums():
    rows = np.arange(64, dtype=np.float32) ** 2  # small integers: sums are exact in any order
    sums = np.empty(8, dtype=np.float32)
    summed(rows, sums)
    np.testing.assert_array_equal(sums, rows.reshape(8, 8).sum(axis=1))


@njit
def powers(exponents, results):
    for k in range(0, len(exponents), 8):
        simd.store(results, k, simd.exp2(simd.load(exponents, k)))


def test_exp2():
    exponents = np.linspace(-126, 127, 80_000, dtype=np.float32)
    results = np.empty_like(exponents)
    powers(exponents, results)
    error = results / np.exp2(exponents.astype(np.float64)) - 1
    assert np.abs(error).max() < 2e-7  # the polynomial's 1.1e-7 and roundings of 6e-8; of all float32 numbers 1.93e-7
    powers(np.zeros(8, dtype=np.float32), results)
    assert (results[:8] == 1).all()


@njit
def walk(number, positions):
    count = 0
    while number != 0:
        positions[count] = simd.lowest_set_bit(number)
        number &= number - np.uint32(1)
        count += 1
    return count


def test_lowest_set_bit():
    positions = np.empty(32, dtype=np.int64)
    assert walk(np.uint32(0x80010003), positions) == 4
    assert positions[:4].tolist() == [0, 1, 16, 31]
    assert walk(np.uint32(0), positions) == 0


@njit
def take(counters):
    return simd.fetch_add(counters, 0, 5)


def test_fetch_add():
    counters = np.array([3, 9], dtype=np.int64)
    assert take(counters) == 3
    assert counters.tolist() == [8, 9]
