"""How Triton kernels are launched. Like Triton, imported only where CUDA is asked for."""

import triton

# Explicit, as the default differs between versions of Triton. UNFUSED: a fused multiply-add where the source says
# tl.fma, and nowhere else; core.rasterizer.cuda says why.
UNFUSED = {"enable_fp_fusion": False}
FUSED = {"enable_fp_fusion": True}
MOST_NUMBERS = 1 << 31  # fewer are in an array: kernels find their place with 32 bits
USE_SMALLER = "Use smaller photos (-r 10000: 10,000 px wide)."  # where a picture has more


def interpreted() -> bool:
    """Whether Triton runs kernels by its interpreter, on CPU tensors;
    decided by TRITON_INTERPRET when Triton is imported."""
    return triton.knobs.runtime.interpret


def blocks(count: int, size: int) -> tuple[int]:
    """The grid that covers `count` with blocks of `size`; one block at least, as a grid cannot be empty."""
    return (max(1, -(-count // size)),)
