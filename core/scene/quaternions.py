"""Unit quaternions w x y z, as in a 3DGS .ply, and the rotations that they stand for."""

import torch
from jaxtyping import Float
from torch import Tensor

OPPOSITE = 1e-12 - 1  # z of what is opposite to the z axis but for rounding


def from_z_onto(normals: Float[Tensor, "n 3"]) -> Float[Tensor, "n 4"]:
    """Unit quaternions, float32, of the shortest turns of the z axis onto these vectors of length 1."""
    x, y, z = normals.unbind(dim=1)
    half_way = torch.stack([1 + z, -y, x, torch.zeros_like(z)], dim=1)  # 1 + n z, z x n
    half_way[z <= OPPOSITE] = half_way.new_tensor([0, 1, 0, 0])  # any half turn
    return torch.nn.functional.normalize(half_way.float(), dim=1)


def rotations(quaternions: Float[Tensor, "n 4"]) -> Float[Tensor, "n 3 3"]:
    """Rotation matrices of quaternions w x y z, which are normalised first."""
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=1).unbind(dim=1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
