"""A camera as an array of 25 numbers: for the CUDA kernels and, on either device, for L_regTS and density control."""

import torch
from jaxtyping import Float
from torch import Tensor

from core.rasterizer.contract import jacobian_limits
from core.scene.camera import Camera

# Positions in the array.
ROTATION = 0  # world to camera, three rows of three
CENTRE = 9  # scene units
# What float32 rounds off the centre. Kernels read the array in float32 and subtract both parts from a mean: together
# they have 14 digits, so that nothing is lost far from the origin.
CENTRE_REST = 12
FOCAL_X, FOCAL_Y, MIDDLE_X, MIDDLE_Y = 15, 16, 17, 18  # px
LEFT, RIGHT, TOP, BOTTOM = 19, 20, 21, 22  # x / z and y / z are clamped to these in the Jacobian, see `jacobian_limits`
WIDTH, HEIGHT = 23, 24  # px


def view_of(camera: Camera) -> Float[Tensor, "25"]:
    """The camera as such an array, float64, on the CPU."""
    centre = torch.tensor(camera.centre, dtype=torch.float64)
    numbers = [
        *camera.world_to_camera.flatten().tolist(),
        *centre.tolist(),
        *(centre - centre.float().double()).tolist(),
        *(camera.fx, camera.fy, camera.cx, camera.cy),
        *jacobian_limits(camera),
        *(camera.width, camera.height),
    ]
    return torch.tensor(numbers, dtype=torch.float64)
