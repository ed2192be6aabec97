"""The way of a camera from one view to others."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline

from core.scene.camera import Camera


def camera_path(views: Sequence[Camera], steps: int, pivot: np.ndarray | None) -> list[Camera]:
    """`steps` cameras, evenly spaced, from the first view through the others to the last: at a constant rate between
    two, without a jolt where they are more; as many times the first if it is the only one.

    pivot: the point (3,) about which the camera moves. In the camera's axes, that point goes from its place in one view
    to its place in the next, straight if there are two, and so stays in the picture. None: the camera itself goes so.

    All have the size and the principal point of the first view. The focal lengths of the others count relative to the
    longer sides of their pictures.
    """
    first = views[0]
    if len(views) == 1:
        return [first] * steps
    numbers, times = np.arange(len(views)), np.linspace(0, len(views) - 1, steps)
    rotations = Rotation.from_matrix(np.array([view.world_to_camera for view in views]))
    turned = RotationSpline(numbers, rotations)(times).as_matrix()
    places = np.array([view.centre if pivot is None else view.in_axes(pivot) for view in views])
    lenses = [np.array([view.fx, view.fy]) / max(view.width, view.height) for view in views]
    moved = PchipInterpolator(numbers, np.column_stack([places, lenses]))(times)  # overshoots nowhere
    places, lenses = moved[:, :3], moved[:, 3:] * max(first.width, first.height)
    centres = places if pivot is None else pivot - np.einsum("tc,tcw->tw", places, turned)
    path = [
        replace(first, world_to_camera=rotation, centre=centre, fx=float(fx), fy=float(fy))
        for rotation, centre, (fx, fy) in zip(turned, centres, lenses, strict=True)
    ]
    return [first, *path[1:]]
