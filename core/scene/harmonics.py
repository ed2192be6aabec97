"""Real spherical harmonics as every 3DGS viewer evaluates them (degrees 0 to 3)."""

import torch
from jaxtyping import Float
from torch import Tensor

from core.errors import BadSetting

# Normalisation and signs of the original 3DGS; viewers share them, so they are part of the file format.
SH_0 = 0.28209479177387814
SH_1 = 0.4886025119029199
SH_2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
SH_3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)
MAX_DEGREE = 3


def coefficient_count(degree: int) -> int:
    """Coefficients per colour channel: 1, 4, 9, 16 for degrees 0..3."""
    if not 0 <= degree <= MAX_DEGREE:
        raise BadSetting(f"SH degree {degree} is not one that 3DGS viewers read.", "Choose 0, 1, 2 or 3.")
    return (degree + 1) ** 2


def degree_of(coefficients: int) -> int:
    """The inverse of `coefficient_count`."""
    for degree in range(MAX_DEGREE + 1):
        if coefficient_count(degree) == coefficients:
            return degree
    raise BadSetting(f"{coefficients} SH coefficients per channel fit no degree.", "Use 1, 4, 9 or 16.")


def basis(directions: Float[Tensor, "n 3"], degree: int) -> Float[Tensor, "n c"]:
    """The SH basis at unit directions, c = (degree + 1)^2; a zero direction yields only the DC term."""
    x, y, z = directions.unbind(-1)
    terms = [torch.full_like(x, SH_0)]
    if degree >= 1:
        terms += [-SH_1 * y, SH_1 * z, -SH_1 * x]
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        terms += [
            SH_2[0] * x * y,
            SH_2[1] * y * z,
            SH_2[2] * (2 * zz - xx - yy),
            SH_2[3] * x * z,
            SH_2[4] * (xx - yy),
        ]
    if degree >= 3:
        terms += [
            SH_3[0] * y * (3 * xx - yy),
            SH_3[1] * x * y * z,
            SH_3[2] * y * (4 * zz - xx - yy),
            SH_3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            SH_3[4] * x * (4 * zz - xx - yy),
            SH_3[5] * z * (xx - yy),
            SH_3[6] * x * (xx - 3 * yy),
        ]
    return torch.stack(terms, dim=-1)


def evaluated(values: Float[Tensor, "n c"], sh: Float[Tensor, "n c 3"]) -> Float[Tensor, "n 3"]:
    """The sums of SH coefficients times the basis' values: colours less 0.5, before the clamp at 0."""
    return (values[..., None] * sh).sum(dim=1)


def colour(sh: Float[Tensor, "n c 3"], directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """Colours in [0, inf) of SH coefficients seen along unit directions: max(0, SH + 0.5)."""
    return (evaluated(basis(directions, degree_of(sh.shape[1])), sh) + 0.5).clamp_min(0.0)


def dc_of_colour(colours: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """The DC coefficients that show `colours` ([0, 1], any shape) from every side."""
    return (colours - 0.5) / SH_0
