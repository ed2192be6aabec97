"""A camera as a short array of numbers: for the CUDA kernels and, on a CPU as well, for what else a training step takes of it."""

import torch
from jaxtyping import Float
from torch import Tensor

from core.rasterizer.contract import jacobian_limits
from core.scene.camera import Camera

# Where what stands in the array.
ROTATION = 0  # world to camera, three rows of three
CENTRE = 9  # scene units
# What float32 rounds off the centre. Kernels read the array in float32 and take both from a mean: good to 14 digits, so that far from the origin
# nothing is lost.
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
