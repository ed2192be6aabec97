"""Vectors of three as tuples, which the compiler keeps in registers."""

import numpy as np

from core.kernels.compiled import part


@part
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@part
def add(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@part
def subtract(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@part
def scaled(factor, a):
    return factor * a[0], factor * a[1], factor * a[2]


@part
def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@part
def row(matrix, i):
    """Row `i` of an (N, 3) array, in float64."""
    return np.float64(matrix[i, 0]), np.float64(matrix[i, 1]), np.float64(matrix[i, 2])
