"""Kernels and their parts (core.kernels.compiled) compiled once more:
to be called from Python, and to show their machine code."""

import platform

import llvmlite.binding
import pytest
from numba import njit


def afresh(function, *signature):
    """With the same options, but without a cache, whose code cannot be inspected; at once if a signature is given."""
    options = {name: value for name, value in function.targetoptions.items() if name in ("error_model", "fastmath")}
    return njit(*signature, **options)(function.py_func)


def assembly_of(function, signature) -> str:
    """The machine code for one signature; skips the test on a processor without 256-bit fused multiply-adds.

    Where the compiler quietly leaves a loop scalar, the result is right and several times as slow: nothing but the
    assembly tells.
    """
    features = llvmlite.binding.get_host_cpu_features()
    if platform.machine() not in ("x86_64", "AMD64") or not (features.get("avx2") and features.get("fma")):
        pytest.skip("this processor has no 256-bit fused multiply-add")
    (assembly,) = afresh(function, signature).inspect_asm().values()
    return assembly
