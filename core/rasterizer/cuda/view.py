"""A camera as the kernels read it: a short float32 array, so that no kernel takes two dozen numbers one by one."""

import torch
import triton.language as tl
from torch import Tensor

from core.rasterizer.contract import jacobian_limits
from core.scene.camera import Camera
from core.system.device import sent

# Where what stands in the array. The centre as two floats, of which the first is it rounded: their sum is good to 14 digits,
# so that a mean far from the origin loses nothing when the centre is taken from it.
ROTATION = tl.constexpr(0)  # world to camera, three rows of three
CENTRE = tl.constexpr(9)  # scene units
CENTRE_REST = tl.constexpr(12)
FOCAL_X, FOCAL_Y, MIDDLE_X, MIDDLE_Y = (tl.constexpr(at) for at in (15, 16, 17, 18))  # px
# x / z and y / z are clamped to these in the Jacobian, see `jacobian_limits`.
LEFT, RIGHT, TOP, BOTTOM = (tl.constexpr(at) for at in (19, 20, 21, 22))
WIDTH, HEIGHT = (tl.constexpr(at) for at in (23, 24))  # px


def view_of(camera: Camera, device: torch.device) -> Tensor:
    """The camera as such an array, on `device`."""
    centre = torch.tensor(camera.centre, dtype=torch.float64)
    rest = centre - centre.float().double()
    numbers = [
        *camera.world_to_camera.flatten().tolist(),
        *centre.tolist(),
        *rest.tolist(),
        *(camera.fx, camera.fy, camera.cx, camera.cy),
        *jacobian_limits(camera),
        *(camera.width, camera.height),
    ]
    return sent(torch.tensor(numbers, dtype=torch.float32), device)
