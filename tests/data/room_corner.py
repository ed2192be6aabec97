"""Photos of a room corner, made here: known cameras, walls full of features."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from core.data import load_collection
from core.data.collection import Collection
from core.data.prepare import prepared
from core.report import Report
from tests.data.converted import write_json

WIDTH, HEIGHT, FOCAL = 320, 240, 380.0
WALLS = (  # corner, and the two edges from it; all 2 units long
    ((-1, -1, 5), (2, 0, 0), (0, 2, 0)),
    ((-1, 1, 3), (2, 0, 0), (0, 0, 2)),
    ((-1, -1, 3), (0, 0, 2), (0, 2, 0)),
)
SQUARE = ((0, 0), (1, 0), (1, 1), (0, 1))


def textures():
    """Three pictures full of corners, coarse and fine."""
    random = np.random.default_rng(1)
    made = []
    for _ in WALLS:
        picture = np.zeros((500, 500, 3), np.uint8)
        for cells in (25, 60):
            noise = random.integers(0, 128, (cells, cells, 3), np.uint8)
            picture += cv2.resize(noise, (500, 500), interpolation=cv2.INTER_NEAREST)
        made.append(picture)
    return made


def cameras(count):
    """World-to-camera rotations and centres on an arc, all looking into the corner."""
    for index in range(count):
        centre = np.array([0.4 + 0.35 * index, -0.6 - 0.1 * (index % 2), -0.3 + 0.1 * index])
        forward = np.array([-0.2, 0.2, 4.4]) - centre
        forward /= np.linalg.norm(forward)
        right = np.cross([0.0, 1.0, 0.0], forward)
        right /= np.linalg.norm(right)
        yield np.stack([right, np.cross(forward, right), forward]), centre


def take_photo(rotation, centre, pictures):
    """The corner seen by a pinhole; farther walls first."""
    photo = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    for (corner, first, second), picture in zip(WALLS, pictures, strict=True):
        world = np.array([np.add(corner, np.multiply(first, u) + np.multiply(second, v)) for u, v in SQUARE])
        local = (world - centre) @ rotation.T
        seen = local[:, :2] / local[:, 2:] * FOCAL + (WIDTH / 2, HEIGHT / 2)
        # OpenCV counts pixels from the middle of the first one.
        warp = cv2.getPerspectiveTransform(
            (np.array(SQUARE) * 500 - 0.5).astype(np.float32), (seen - 0.5).astype(np.float32)
        )
        wall = cv2.warpPerspective(picture, warp, (WIDTH, HEIGHT), flags=cv2.INTER_AREA)
        inside = cv2.warpPerspective(np.full(picture.shape[:2], 255, np.uint8), warp, (WIDTH, HEIGHT)) == 255
        photo[inside] = wall[inside]
    return photo


def save_corner(folder: Path, names: Sequence[str]) -> Path:
    """Photos of the corner by these names, one from each of its cameras, in `folder`, which is made and returned."""
    folder.mkdir(exist_ok=True)
    pictures = textures()
    for name, pose in zip(names, cameras(len(names)), strict=True):
        assert cv2.imwrite(str(folder / name), take_photo(*pose, pictures))
    return folder


def write_corner(root: Path, count: int = 6, masked: int | None = None) -> Path:
    """A transforms.json in `root`, which is returned, of photos 0.png, 1.png, ...
    and no points; `masked` has its lower half hidden."""
    names, frames = [f"{number}.png" for number in range(count)], []
    save_corner(root, names)
    for name, (rotation, centre) in zip(names, cameras(count), strict=True):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation.T * [1, -1, -1], centre
        frames.append({"file_path": name, "transform_matrix": matrix.tolist()})
    if masked is not None:
        mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
        mask[HEIGHT // 2 :] = 0
        assert cv2.imwrite(str(root / "mask.png"), mask)
        frames[masked]["mask_path"] = "mask.png"
    write_json(root / "transforms.json", {"fl_x": FOCAL, "frames": frames})
    return root


def corner_with_points(folder: Path) -> Collection:
    """The corner and its points, triangulated, below `folder`; photo 0 is held out."""
    (folder / "corner").mkdir()
    return load_collection(prepared(write_corner(folder / "corner"), folder / "points", Report()).read_from)
