"""Positional encoding gamma (NeRF, eq. 4) and the contraction of far points (mip-NeRF 360, eq. 10)."""

from math import pi

import torch
from jaxtyping import Float
from torch import Tensor


def encoded_size(size: int, octaves: int) -> int:
    """Columns that `encode` makes of `size` columns."""
    return size * (1 + 2 * octaves)


def encode(values: Float[Tensor, "n d"], octaves: int) -> Float[Tensor, "n e"]:
    """gamma(x) = (x, sin(2^0 pi x), cos(2^0 pi x), ..., sin(2^(octaves-1) pi x), cos(...)), e = d (1 + 2 octaves).

    NeRF leaves the identity out; it is kept here, as in NeRF's code, so that 0 octaves pass the values through.
    The octaves follow from each other by sin 2a = 2 sin a cos a and cos 2a = 1 - 2 sin^2 a: two transcendental
    functions a value instead of 2 * octaves. The rounding error doubles with each octave, as it does for the angle.
    """
    columns = [values]
    if octaves:
        angle = values * pi
        sine, cosine = torch.sin(angle), torch.cos(angle)
        columns += [sine, cosine]
        for _ in range(octaves - 1):
            sine, cosine = 2 * sine * cosine, 1 - 2 * sine * sine
            columns += [sine, cosine]
    return torch.cat(columns, dim=1)


def contract(means: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """Centres in the scene frame -> [-1, 1]: x inside the unit ball, (2 - 1/|x|) x/|x| outside; then halved.

    Only exactly rounded operations per row (no library reduction), so a row's result does not depend on its place.
    """
    x, y, z = means.unbind(1)
    norm = (x * x + y * y + z * z).sqrt().clamp_min(1.0)[:, None]
    return means / norm * (1.0 - 0.5 / norm)


def encoded_positions(means: Float[Tensor, "n 3"], octaves: int) -> Float[Tensor, "n e"]:
    """encode(contract(means), octaves): the centres (scene frame) as the SH transfer takes them; without a gradient."""
    means = means.detach()
    if means.device.type == "cuda" and means.dtype == torch.float32:
        from core.appearance import positional_encoding_cuda  # Triton, which is there with a GPU only

        return positional_encoding_cuda.encoded_positions(means, octaves)
    return encode(contract(means), octaves)
