"""Vectors of three as tuples, one entry per lane: Triton keeps them in registers."""

import triton
import triton.language as tl


@triton.jit
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@triton.jit
def add(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@triton.jit
def subtract(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@triton.jit
def scaled(factor, a):
    return factor * a[0], factor * a[1], factor * a[2]


@triton.jit
def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@triton.jit
def unit(a):
    """a over its length, and the inverse of that length; zeros for the zero vector."""
    length = tl.sqrt_rn(dot(a, a))
    inverse = tl.where(length > 0, 1.0 / length, 0.0)
    return scaled(inverse, a), inverse


@triton.jit
def load_3(array, row, known):
    """Row `row` of an (N, 3) array, zeros where `known` is false."""
    return (
        tl.load(array + 3 * row, mask=known, other=0.0),
        tl.load(array + 3 * row + 1, mask=known, other=0.0),
        tl.load(array + 3 * row + 2, mask=known, other=0.0),
    )


@triton.jit
def store_3(array, row, a, known):
    """Write row `row` of an (N, 3) array where `known` is true."""
    tl.store(array + 3 * row, a[0], mask=known)
    tl.store(array + 3 * row + 1, a[1], mask=known)
    tl.store(array + 3 * row + 2, a[2], mask=known)


@triton.jit
def constants_3(array, at):
    """Three numbers that are the same in all lanes."""
    return tl.load(array + at), tl.load(array + at + 1), tl.load(array + at + 2)


@triton.jit
def load_4(array, at, known):
    """Four numbers that lie beside each other, from `at` on, zeros where `known` is false:
    one instruction where `at` is a multiple of 4."""
    numbers = tl.load(array + at[:, None] + tl.arange(0, 4)[None, :], mask=known[:, None], other=0.0)
    even, odd = tl.split(tl.reshape(numbers, (at.shape[0], 2, 2)))
    first, third = tl.split(even)
    second, fourth = tl.split(odd)
    return first, second, third, fourth


@triton.jit
def store_4(array, at, a, known):
    """Write four numbers beside each other, as `load_4` reads them."""
    numbers = tl.reshape(tl.join(tl.join(a[0], a[2]), tl.join(a[1], a[3])), (at.shape[0], 4))
    tl.store(array + at[:, None] + tl.arange(0, 4)[None, :], numbers, mask=known[:, None])
