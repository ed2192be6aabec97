"""The way of a camera from one view to others."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline

from core.scene.camera import Camera

LEAST_ANGLE = 1e-6  # between two views, radians


def camera_path(views: Sequence[Camera], steps: int, pivot: np.ndarray | None) -> list[Camera]:
    """`steps` cameras, evenly spaced, from the first view through the others to the last: at a constant rate between
    two, without a jolt where they are more; as many times the first if it is the only one.

    pivot: the point (3,), in front of all views, about which the camera moves: its pixel and its depth go from those in
    one view to those in the next, straight if there are two. None: the centre of the camera goes so.

    All have the size and the principal point of the first view. The focal lengths of the others count relative to the
    longer sides of their pictures.
    """
    first = views[0]
    if len(views) == 1:
        return [first] * steps
    rotations = Rotation.from_matrix(np.array([view.world_to_camera for view in views]))
    # By the angle that the views turn, or else the spline would overshoot them where some turn less than others.
    angles = np.append(0, np.cumsum(np.maximum((rotations[1:] * rotations[:-1].inv()).magnitude(), LEAST_ANGLE)))
    focal = np.array([(view.fx, view.fy) for view in views]) / [[max(view.width, view.height)] for view in views]
    if pivot is None:
        places = np.array([view.centre for view in views])
    else:
        places = np.array([view.in_axes(pivot) for view in views])
        places[:, :2] *= focal / places[:, 2:]
    numbers, times = np.arange(len(views)), np.linspace(0, len(views) - 1, steps)
    moved = PchipInterpolator(numbers, np.column_stack([angles, focal, places]))(times)  # never beyond two neighbours
    angle, focal, places = moved[:, 0], moved[:, 1:3], moved[:, 3:]
    turned = RotationSpline(angles, rotations)(angle).as_matrix()
    if pivot is not None:
        places[:, :2] *= places[:, 2:] / focal
        places = pivot - np.einsum("tc,tcw->tw", places, turned)
    path = [
        replace(first, world_to_camera=rotation, centre=centre, fx=float(fx), fy=float(fy))
        for rotation, centre, (fx, fy) in zip(turned, places, focal * max(first.width, first.height), strict=True)
    ]
    return [first, *path[1:]]
