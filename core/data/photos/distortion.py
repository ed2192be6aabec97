"""Lens distortion: any COLMAP camera model, turned into the pinhole picture that the engine works with."""

from typing import Any

import cv2
import numpy as np
import pycolmap

from core.errors import BadInput
from core.scene.camera import LARGEST_PX, Camera
from core.scene.lens import Lens

NEGLIGIBLE_PX = 0.01  # a lens that moves no pixel of the photo farther than this is a pinhole
ROUND_TRIP_PX = 1.0  # a pixel whose ray does not lead back to it lies where the lens formula folds over
NODES = 65  # a side of a grid of pixels; if all of their rays lead back to them, so do those of the others
BLOCK_PIXELS = 1 << 20  # rays are followed in blocks of rows, to bound memory
LARGEST_REMAPPED_PX = 32_766  # a side, of the pictures that OpenCV's remap takes and makes
MODELS = pycolmap.CameraModelId.__members__.keys() - {"INVALID"}

# EXIF orientation -> rotation from the camera of the stored pixels to that of the displayed ones. The others are
# mirrors, which no camera can be.
TURNS = {
    1: np.eye(3),
    3: np.diag([-1.0, -1.0, 1.0]),
    6: np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    8: np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
}


def lens_of(camera: pycolmap.Camera, orientation: int = 1) -> Lens:
    """The camera's lens; orientation as in Lens."""
    return Lens(
        camera.model_name, int(camera.width), int(camera.height), [float(value) for value in camera.params], orientation
    )


def colmap_camera(lens: Lens) -> pycolmap.Camera:
    """The lens as a camera of COLMAP's."""
    return pycolmap.Camera(model=lens.model, width=lens.width, height=lens.height, params=lens.params)


def is_usable(camera: pycolmap.Camera) -> bool:
    """Whether the camera (not a panorama) has a positive size,
    and parameters up to LARGEST_PX with positive focal lengths."""
    if min(camera.width, camera.height) < 1 or not (np.abs(camera.params) < LARGEST_PX).all():  # so that NaN fails it
        return False
    return min(camera.focal_length_x, camera.focal_length_y) > 0


def stated_lens(facts: Any) -> Lens | None:
    """The lens of these facts, the fields of a Lens as a JSON file has them; None if they are damaged, so that
    `undistort` could not work with them. The orientation may be missing; what else is there is ignored."""
    needed = ("model", "width", "height", "params")
    if not (isinstance(facts, dict) and all(name in facts for name in needed)):
        return None
    (model, width, height, params), orientation = (facts[name] for name in needed), facts.get("orientation", 1)
    is_model = isinstance(model, str) and model in MODELS
    is_turn = type(orientation) is int and orientation in TURNS
    are_sides = all(type(side) is int and 0 < side < 1 << 64 for side in (width, height))  # pycolmap takes no larger
    are_params = isinstance(params, list) and all(
        type(value) in (int, float) and abs(value) < LARGEST_PX for value in params
    )
    if not (is_model and is_turn and are_sides and are_params):
        return None
    lens = Lens(model, width, height, params, orientation)
    camera = colmap_camera(lens)
    return lens if camera.verify_params() and not camera.is_spherical() and is_usable(camera) else None


def is_pinhole(camera: pycolmap.Camera) -> bool:
    """Whether no pixel is farther than NEGLIGIBLE_PX from where a pinhole would put it; tested on a grid."""
    x, y = np.meshgrid(np.linspace(0, camera.width, 17), np.linspace(0, camera.height, 17))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    moved = camera.img_from_cam(rays(pixels, *_intrinsics(camera)))
    return bool((np.abs(moved - pixels) <= NEGLIGIBLE_PX).all())  # False for NaN, a ray that the lens cannot see


def folds_over(camera: pycolmap.Camera) -> bool:
    """Whether no ray leads to some pixel of the photo, because the lens formula folds over before it;
    tested along the edge."""
    along = np.linspace(0, 1, 17)
    edge = np.concatenate([np.column_stack([along, np.full(17, side)]) for side in (0, 1)])
    pixels: np.ndarray = np.concatenate([edge, edge[:, ::-1]]) * (camera.width, camera.height)
    directions: np.ndarray = np.column_stack([camera.cam_from_img(pixels), np.ones(len(pixels))])
    # True for NaN.
    return not bool((np.linalg.norm(camera.img_from_cam(directions) - pixels, axis=1) < ROUND_TRIP_PX).all())


def pinhole(camera: pycolmap.Camera, width: int, height: int) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy (px) of the undistorted picture of a photo of `width` x `height` px.

    Focal lengths and principal point stay the lens's own, so the middle of the picture keeps its sharpness. What a
    barrel lens saw beyond the pinhole's edge is cut off; what a cushion lens did not see is marked invalid.
    """
    fx, fy, cx, cy = _intrinsics(camera)
    x, y = width / camera.width, height / camera.height
    return fx * x, fy * y, cx * x, cy * y


def turned(camera: Camera, orientation: int) -> Camera:
    """The camera of stored pixels as the camera of the displayed picture; orientation is a key of TURNS."""
    rotation = TURNS[orientation] @ camera.world_to_camera
    width, height = camera.width, camera.height
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    if orientation == 3:
        cx, cy = width - cx, height - cy
    elif orientation == 6:
        fx, fy, cx, cy, width, height = fy, fx, height - cy, cx, height, width
    elif orientation == 8:
        fx, fy, cx, cy, width, height = fy, fx, cy, width - cx, height, width
    return Camera(rotation, camera.centre, fx, fy, cx, cy, width, height)


def undistort(pixels: np.ndarray, lens: Lens, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The picture that `camera` (a pinhole, at the size wanted) sees in a distorted one, and where it is valid.

    pixels: (h, w, channels) uint8 at any size of the lens's aspect; stored, not displayed, where the lens has an
    orientation other than 1. Returns (H, W, channels) uint8 and (H, W) bool. Bicubic, as bilinear would blur twice
    together with the resizing that follows. Raises BadInput for sides beyond LARGEST_REMAPPED_PX.
    """
    height, width = pixels.shape[:2]
    if max(width, height, camera.width, camera.height) > LARGEST_REMAPPED_PX:
        raise BadInput(
            f"A picture of {width} x {height} px is too large to be undistorted.",
            f"Use a smaller copy, or train on shrunk photos (-r 4): {LARGEST_REMAPPED_PX:,} px a side are possible.",
        )
    turn = TURNS[lens.orientation]
    model = colmap_camera(lens)
    to_pixels = np.array([width / lens.width, height / lens.height])
    focal = np.array([camera.fx, camera.fy])

    def project_into_lens(wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The rays (N, 3) of these pixels (N, 2), in the lens's axes,
        and at which of its own pixels (N, 2) the lens shows them."""
        directions = rays(wanted, camera.fx, camera.fy, camera.cx, camera.cy) @ turn  # = turn^-1 applied to each row
        return directions, model.img_from_cam(directions)

    def reprojection_error_px(directions: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """How far (px) the rays that the lens formula gives for the pixels
        `seen` are from the rays that led to these."""
        return np.linalg.norm((model.cam_from_img(seen) - directions[:, :2]) * focal, axis=1)

    x, y = np.meshgrid(np.linspace(0, camera.width, NODES), np.linspace(0, camera.height, NODES))
    errors_px = reprojection_error_px(*project_into_lens(np.stack([x.ravel(), y.ravel()], axis=1)))
    lens_folds = not (errors_px < NEGLIGIBLE_PX).all()  # True for NaN
    picture = np.empty((camera.height, camera.width, pixels.shape[2]), np.uint8)
    valid = np.empty((camera.height, camera.width), bool)
    rows = max(1, BLOCK_PIXELS // camera.width)
    remap_options: dict[str, Any] = {"map2": None, "interpolation": cv2.INTER_CUBIC, "borderMode": cv2.BORDER_REPLICATE}
    for top in range(0, camera.height, rows):
        y, x = np.mgrid[top : min(top + rows, camera.height), : camera.width] + 0.5
        directions, seen = project_into_lens(np.stack([x.ravel(), y.ravel()], axis=1))
        source = seen * to_pixels
        inside = ((source >= 0) & (source <= (width, height))).all(axis=1)
        if lens_folds:
            inside &= reprojection_error_px(directions, seen) < ROUND_TRIP_PX
        # Far outside, remap's fixed-point coordinates would overflow.
        source = np.clip(np.nan_to_num(source - 0.5), -2, max(width, height) + 2).astype(np.float32)
        block = slice(top, top + x.shape[0])
        source = source.reshape(*x.shape, 2)
        # As many channels as OpenCV remaps at once.
        fours = (pixels[..., first : first + 4] for first in range(0, pixels.shape[2], 4))
        picture[block] = np.dstack([cv2.remap(four, source, **remap_options) for four in fours])
        valid[block] = inside.reshape(x.shape)
    return picture, valid


def _intrinsics(camera: pycolmap.Camera) -> tuple[float, float, float, float]:
    return camera.focal_length_x, camera.focal_length_y, camera.principal_point_x, camera.principal_point_y


def rays(pixels: np.ndarray, fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    """Directions (N, 3) with z = 1 of pixel positions (N, 2) of a pinhole."""
    return np.column_stack([(pixels[:, 0] - cx) / fx, (pixels[:, 1] - cy) / fy, np.ones(len(pixels))])
