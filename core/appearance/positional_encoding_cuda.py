"""The encoded positions of Gaussians on a GPU: core.appearance.positional_encoding in one launch,
where plain torch takes thirty."""

import math

import triton
import triton.language as tl
from jaxtyping import Float
from torch import Tensor

from core.appearance.positional_encoding import encoded_size
from core.kernels.triton_launch import FUSED, blocks

BLOCK = 128  # Gaussians per program, one per thread
PI = tl.constexpr(math.pi)


@triton.jit(do_not_specialize=["count"])
def encode_positions(means, positions, count, OCTAVES: tl.constexpr, BLOCK: tl.constexpr):
    """Write encode(contract(means), OCTAVES) of (count, 3) to `positions` (count, 3 (1 + 2 OCTAVES))."""
    row = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    known = row < count
    x = tl.load(means + 3 * row, mask=known, other=0.0)
    y = tl.load(means + 3 * row + 1, mask=known, other=0.0)
    z = tl.load(means + 3 * row + 2, mask=known, other=0.0)
    norm = tl.maximum(tl.sqrt_rn(x * x + y * y + z * z), 1.0)
    for axis in tl.static_range(3):
        at = positions + row * (3 + 6 * OCTAVES) + axis
        value = tl.load(means + 3 * row + axis, mask=known, other=0.0) / norm * (1.0 - 0.5 / norm)
        tl.store(at, value, mask=known)
        sine, cosine = tl.sin(value * PI), tl.cos(value * PI)
        for octave in tl.static_range(OCTAVES):
            tl.store(at + (3 + 6 * octave), sine, mask=known)
            tl.store(at + (6 + 6 * octave), cosine, mask=known)
            sine, cosine = sine * cosine * 2.0, 1.0 - sine * sine * 2.0


def encoded_positions(means: Float[Tensor, "n 3"], octaves: int) -> Float[Tensor, "n e"]:
    """`positional_encoding.encoded_positions` for float32 on a GPU."""
    positions = means.new_empty(len(means), encoded_size(3, octaves))
    encode_positions[blocks(len(means), BLOCK)](
        means.contiguous(), positions, len(means), OCTAVES=octaves, BLOCK=BLOCK, **FUSED
    )
    return positions
