"""Kernels and their parts (core.kernels.compiled) compiled once more: to be called from Python, and to show their machine code."""

from numba import njit


def afresh(function, *signature):
    """With the same options, but without a cache, whose code cannot be inspected; at once if a signature is given."""
    options = {name: value for name, value in function.targetoptions.items() if name in ("error_model", "fastmath")}
    return njit(*signature, **options)(function.py_func)
