"""A camera as the kernels take it: numbers and tuples, which Numba knows."""

from typing import NamedTuple

import numpy as np

from core.rasterizer.contract import jacobian_limits
from core.scene.camera import Camera


class View(NamedTuple):
    """What kernels take of a camera, in their order.

    rotation: (3, 3) float64, world to camera. centre: scene units. lens: fx, fy, cx, cy, px. limits: see
    `jacobian_limits`. size: width, height, px.
    """

    rotation: np.ndarray
    centre: tuple[float, float, float]
    lens: tuple[float, float, float, float]
    limits: tuple[float, float, float, float]
    size: tuple[int, int]

    @classmethod
    def of(cls, camera: Camera) -> "View":
        x, y, z = map(float, camera.centre)
        return cls(
            rotation=np.ascontiguousarray(camera.world_to_camera, dtype=np.float64),
            centre=(x, y, z),
            lens=(float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)),
            limits=jacobian_limits(camera),
            size=(int(camera.width), int(camera.height)),
        )
