"""What is asked of a CUDA driver for the same launches, by Triton's own launcher and by ours.

For a process of its own: Triton decides when it is imported whether kernels are compiled or interpreted, and the system
where it finds libcuda.so.1, which is to be the stand-in.
"""

import ctypes
import json
import re

import torch
import triton
import triton.language as tl
from triton.backends.nvidia.driver import CudaDriver
from triton.runtime import driver

from core.system import triton_driver

STREAM = 0x123456789
STAND_IN = ctypes.CDLL("libcuda.so.1")
STAND_IN.stand_in_log.restype = ctypes.c_char_p


@triton.jit
def every_kind(a, b, c, nothing, yes, no, small, large, huge, half, one, pair, nested, NAME: tl.constexpr):
    value = tl.load(a) + tl.load(b) + tl.load(c) + small + large + huge + half + one + pair[0] + tl.load(nested[1][0])
    if nothing is None:
        value += yes.to(tl.int32) - no.to(tl.int32)
    tl.store(a, value + nested[0])


def launches():
    """Kernels with their grids, arguments and options."""
    floats, bytes_, integers = torch.rand(64), torch.zeros(64, dtype=torch.uint8), torch.zeros(64, dtype=torch.int64)
    nested = (7, (floats[1:], 2.5))  # an address that 16 does not divide
    kinds = (floats, bytes_, integers, None, True, False, -3, 1 << 40, (1 << 63) + 5, 0.1, 1, (4, 16), nested)
    yield every_kind, (3, 2, 5), kinds, {"NAME": 9, "num_warps": 2}
    yield every_kind, (1,), kinds, {"NAME": 9}
    yield every_kind, (0,), kinds, {"NAME": 9}
    parts = (torch.rand(100), torch.rand(100))
    yield triton_driver.scaled_sums, (2,), (torch.rand(100), parts, 99, 0.5), {"BLOCK": 64}


def parameter_sizes(kernel) -> list[int]:
    """Bytes of each parameter of a compiled kernel, by its PTX."""
    kinds = re.findall(r"\.param \.([a-z])(\d+)", kernel.asm["ptx"].partition(")")[0])
    return [int(bits) // 8 for _, bits in kinds]


def on_stand_in(chosen):
    """A driver, made to believe in a GPU."""
    chosen.get_current_device, chosen.get_current_stream = lambda: 0, lambda _: STREAM
    chosen.get_device_capability = lambda *_: (9, 0)
    return chosen


def logs(chosen, asked: list) -> list[str]:
    driver.set_active(on_stand_in(chosen))
    found = []
    for kernel, grid, arguments, options in asked:
        kernel.device_caches.clear()
        compiled = kernel.warmup(*arguments, grid=grid, **options)
        sizes = parameter_sizes(compiled)
        STAND_IN.stand_in_begin((ctypes.c_size_t * len(sizes))(*sizes), len(sizes))
        kernel[grid](*arguments, **options)
        found.append(STAND_IN.stand_in_log().decode())
    return found


def tell() -> None:
    """Print JSON: {"theirs": [log of a launch, ...], "ours": [...]}."""
    asked = list(launches())  # the same arrays for both
    print(json.dumps({"theirs": logs(CudaDriver(), asked), "ours": logs(triton_driver.Driver(), asked)}))
