"""Triton's kernels, launched by ctypes: for machines on which Triton's own launcher cannot be made.

Triton compiles that one, in C, when it is first used. This takes a C compiler and Python's headers, which pip does not
install; everything else, the assembler included, comes with Triton. So this module makes the calls of Triton's
driver.c, as far as kernels like ours need them: without clusters, cooperation, scratch memory, tensor maps or much
shared memory. A launch takes some microseconds longer. Imported only where there is a GPU.
"""

import ctypes
from collections.abc import Iterator

import torch
import triton
import triton.language as tl
from triton.backends.driver import GPUDriver
from triton.backends.nvidia.driver import CudaDriver
from triton.runtime import driver

MAX_THREADS_PER_BLOCK, LOCAL_SIZE_BYTES, NUM_REGS = 0, 3, 4  # attributes of a kernel (cuda.h)
SHARED_BYTES = 48 << 10  # of a block; for more, a kernel has to be set up
WARP = 32

C_TYPES = {f"i{bits}": getattr(ctypes, f"c_int{bits}") for bits in (8, 16, 32, 64)}
C_TYPES |= {f"u{bits}": getattr(ctypes, f"c_uint{bits}") for bits in (8, 16, 32, 64)}
C_TYPES |= {"i1": ctypes.c_int8, "u1": ctypes.c_uint8, "fp32": ctypes.c_float, "fp64": ctypes.c_double}


class Cuda:
    """The library of the CUDA driver. A call by name raises RuntimeError unless it succeeds."""

    def __init__(self):
        self.library = ctypes.CDLL("libcuda.so.1")
        pointer, number = ctypes.c_void_p, ctypes.c_uint
        self.library.cuLaunchKernel.argtypes = [pointer, *[number] * 7, pointer, pointer, pointer]

    def call(self, name: str, *arguments) -> None:
        if status := getattr(self.library, name)(*arguments):
            words = ctypes.c_char_p()
            self.library.cuGetErrorString(status, ctypes.byref(words))
            raise RuntimeError(f"CUDA error of {name}: {(words.value or b'unknown error').decode()}")

    def number(self, name: str, *arguments) -> int:
        """What a function writes to an int, its first argument."""
        result = ctypes.c_int()
        self.call(name, ctypes.byref(result), *arguments)
        return result.value

    def handle(self, name: str, *arguments) -> ctypes.c_void_p:
        """What a function writes to a handle, its first argument."""
        result = ctypes.c_void_p()
        self.call(name, ctypes.byref(result), *arguments)
        return result

    def give_context(self, device: int) -> None:
        """torch's context of a device to this thread, unless it has one."""
        if not self.handle("cuCtxGetCurrent"):
            self.call("cuCtxSetCurrent", self.handle("cuDevicePrimaryCtxRetain", device))

    # What Triton asks of the module that it would have compiled.

    def get_device_properties(self, device: int) -> dict[str, int]:
        return {"max_shared_mem": SHARED_BYTES}

    def load_binary(self, name: str, binary: bytes, shared_bytes: int, device: int) -> tuple[int | None, ...]:
        """Module and function of a compiled kernel, its registers, spilled words and the most threads of a block."""
        self.give_context(device)
        module = self.handle("cuModuleLoadData", binary)
        function = self.handle("cuModuleGetFunction", module, name.encode())
        registers, spilled_bytes, threads = (
            self.number("cuFuncGetAttribute", which, function)
            for which in (NUM_REGS, LOCAL_SIZE_BYTES, MAX_THREADS_PER_BLOCK)
        )
        return module.value, function.value, registers, spilled_bytes // 4, threads

    def unload_module(self, module: int) -> None:  # from Triton 3.9 on
        self.call("cuModuleUnload", ctypes.c_void_p(module))


class Launcher:
    """Launches a compiled kernel. source: what it was compiled from, with the types of its parameters."""

    def __init__(self, source, metadata):
        others = ("launch_cooperative_grid", "launch_pdl", "global_scratch_size", "profile_scratch_size")
        if metadata.num_ctas != 1 or any(getattr(metadata, name) for name in others):
            raise NotImplementedError(f"{metadata.name} asks for more than a plain launch.")
        self.types = tuple(source.signature.values())

    def __call__(self, x, y, z, stream, function, packed, launch_metadata, on_enter, on_exit, *arguments) -> None:
        if not x * y * z:
            return
        cuda, (warps, _, shared_bytes) = driver.active.utils, packed
        cuda.give_context(driver.active.get_current_device())
        # The last two parameters of any kernel point to scratch memory.
        values = [*in_c(self.types, arguments), ctypes.c_void_p(), ctypes.c_void_p()]
        addresses = (ctypes.c_void_p * len(values))(*map(ctypes.addressof, values))
        cuda.call("cuLaunchKernel", function, x, y, z, WARP * warps, 1, 1, shared_bytes, stream, addresses, None)


def in_c(types: tuple, arguments: tuple) -> Iterator:
    """The arguments of a kernel that are not compiled into it, as its machine code takes them; tuples in a row."""
    for kind, argument in zip(types, arguments, strict=True):
        if isinstance(kind, tuple):
            yield from in_c(kind, argument)
        elif kind.startswith("*"):
            yield ctypes.c_void_p(None if argument is None else argument.data_ptr())
        elif kind != "constexpr":
            yield C_TYPES[kind](argument)


class Driver(CudaDriver):
    """Triton's, but for what it compiles in C."""

    def __init__(self):
        GPUDriver.__init__(self)
        self.utils, self.launcher_cls = Cuda(), Launcher


@triton.jit
def scaled_sums(sums, parts, count, factor, BLOCK: tl.constexpr):
    """A kernel with a parameter of each kind: count sums of two arrays, times a factor."""
    offsets = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = offsets < count
    total = tl.load(parts[0] + offsets, mask=inside) + tl.load(parts[1] + offsets, mask=inside)
    tl.store(sums + offsets, total * factor, mask=inside)


def install() -> None:
    """Make Triton launch by ctypes from now on. Raises RuntimeError or OSError if that does not work either."""
    driver.set_active(Driver())
    count, block = 100, 64
    parts = tuple(torch.arange(start, start + count, dtype=torch.float32, device="cuda") for start in (0, 7))
    sums = torch.zeros(count, device="cuda")
    scaled_sums[(triton.cdiv(count, block),)](sums, parts, count - 1, 0.5, BLOCK=block)
    expected = (parts[0] + parts[1]) * 0.5
    expected[-1] = 0
    if not torch.equal(sums, expected):
        raise RuntimeError("a kernel that was launched without it gave wrong numbers")
