"""Checks of Gaussians as cameras see them: how far rounding to float32 moves them in a picture,
and which no camera sees."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import torch

import core.rasterizer
from core.data.posed import Fault, from_camera_to_world
from core.doctor.finding import Finding, counting
from core.errors import BadInput
from core.rasterizer.contract import ALPHA_MIN
from core.rasterizer.importance import largest_contributions
from core.report import Report
from core.scene.camera import Camera, can_be_drawn
from core.scene.frame import SceneFrame
from core.scene.splats import Splats
from core.words import counted

VISIBLE_PX = 0.1  # a shift that begins to show in sharp detail
PICTURE_PX = 500.0  # the size of a scene radius in a picture, as assumed without cameras
UNSEEN = 0.1  # share of Gaussians that may be seen by no photo
WIDEST_PX = 640  # views are rendered at most this wide to see which Gaussians show
SAMPLE = 2000  # centres, from which the depth of a view is estimated


def centres_of(splats: Splats, sky_count: int) -> np.ndarray:
    """The finite centres (P, 3), float64, of all but the last `sky_count` Gaussians."""
    solid = splats.means[: len(splats) - sky_count]
    return solid[torch.isfinite(solid).all(dim=1)].double().numpy()


def float32_error(frame: SceneFrame, means: np.ndarray, cameras: list[Camera]) -> Finding:
    """How far rounding to float32 moves a coordinate of the scene.
    means, cameras: scene frame; frame: that of the file."""
    error = frame.rounding / frame.radius
    shifts_px = [error * max(camera.fx, camera.fy) / depth for camera in cameras if (depth := _depth(camera, means))]
    if shifts_px:
        usual_px = float(np.median(shifts_px))
        where = f"in the median of {counted(len(shifts_px), 'camera')}, {max(shifts_px):.2g} px at most"
    else:
        usual_px = error * PICTURE_PX
        where = f"where the scene's radius takes {PICTURE_PX:.0f} px"
    advice = "Recentre the file; what `wegs bake` writes is." if usual_px > VISIBLE_PX else ""
    figure = f"{frame.rounding:.2g} units, {usual_px:.2g} px {where}"
    return Finding(
        "float32 positions", figure, "how far coordinates of this size are rounded", advice, "Recentre the file."
    )


def _depth(camera: Camera, means: np.ndarray) -> float | None:
    """The median depth of the centres that the camera sees, or None if it sees none."""
    inside, depths = camera.shows(means[:: max(1, len(means) // SAMPLE)])
    return float(np.median(depths[inside])) if inside.any() else None


def never_seen(splats: Splats, cameras: list[Camera], sky_count: int, report: Report) -> Finding:
    """How many Gaussians contribute 1/255 or more to no pixel of any camera;
    the last `sky_count` rows do not count. Scene frame."""
    rasterizer, small = core.rasterizer.create("auto"), [camera.shrunk(WIDEST_PX / camera.width) for camera in cameras]
    try:
        largest = largest_contributions(splats, small, rasterizer, partial(report.progress, "Views"))
    except BadInput as problem:  # Gaussians so large that the rasterizer refuses them
        return Finding(
            "never seen",
            "not measured",
            problem.what.rstrip("."),
            "Train with a smaller largest_scale.",
            "Remove the giants first.",
        )
    solid = len(splats) - sky_count
    unseen = int((largest[:solid] < ALPHA_MIN).sum())
    advice = "Train with prune_contribution above 0, which removes them." if unseen > UNSEEN * solid else ""
    meaning = f"below 1/255 of every pixel of {counted(len(cameras), 'camera')}: no photo holds them in place"
    return counting("never seen", unseen, solid, meaning, advice, "Remove them.")


def cameras_beside(path: Path) -> list[Camera]:
    """The cameras (world frame) of the run folder that a .ply lies in, from the original project's cameras.json.

    Empty where there is none; raises BadInput where it is damaged.
    """
    near = [*path.absolute().parents][:3]
    # Beside the .ply, or above its point_cloud/iteration_N/.
    folders = [near[0], *near[2:]] if path.absolute().parts[-3:-2] == ("point_cloud",) else near[:1]
    file = next((folder / "cameras.json" for folder in folders if (folder / "cameras.json").is_file()), None)
    if file is None:
        return []
    try:
        return [_camera(values) for values in json.loads(file.read_bytes())]
    except Fault as fault:
        raise BadInput(f"{file} cannot be used: it holds a camera {fault}.", "Export it again.") from None
    except (OSError, ValueError, KeyError, TypeError, OverflowError) as problem:
        raise BadInput(f"{file} cannot be used: {type(problem).__name__}: {problem}.", "Export it again.") from None


def _camera(values: dict) -> Camera:
    """The camera of an entry of cameras.json. Raises Fault for one that nothing can be drawn with, and what Python
    raises for values that are missing or no numbers."""
    axes, centre = (
        np.array(values[name], dtype=np.float64).reshape(shape)
        for name, shape in (("rotation", (3, 3)), ("position", 3))
    )
    rotation, centre = from_camera_to_world(np.column_stack([axes, centre]), "a pose")
    width, height = int(values["width"]), int(values["height"])
    lens = (
        float(values["fx"]),
        float(values["fy"]),
        float(values.get("cx", width / 2)),
        float(values.get("cy", height / 2)),
    )
    if not can_be_drawn(width, height, lens):
        raise Fault(f"of {width} x {height} px that cannot be drawn with")
    return Camera(rotation, centre, *lens, width, height)
