"""A Blender scene of which it is known where it is empty:
balls in a ball, transparent around them, among points that lie where nothing is."""

from pathlib import Path

import cv2
import numpy as np

import core.rasterizer
from core.export.ply import write_points
from tests.data.converted import write_json
from tests.small import ring_camera
from tests.training.known_scene import balls

WIDTH, HEIGHT = 80, 60
# Points of nothing, and between which distances from the middle they lie; the balls end at 0.9.
STRAY, SHELL = 150, (1.2, 1.6)


def write_transparent_scene(root: Path, photos: int = 12) -> Path:
    """transforms_train.json and transforms_test.json
    (every third photo) with RGBA photos and points.ply in `root`, which is returned."""
    random = np.random.default_rng(7)
    splats, points, colours = balls(random)
    rasterizer, frames = core.rasterizer.create("cpu"), {"train": [], "test": []}
    for index in range(photos):
        camera = ring_camera(2 * np.pi * index / photos).resized(WIDTH, HEIGHT)
        alpha = rasterizer.render(splats.marked(slice(None)), camera).numpy()[..., :1]
        straight = rasterizer.render(splats, camera).numpy() / np.maximum(alpha, 1e-6)
        split = "test" if index % 3 == 2 else "train"
        path = root / split / f"r_{index}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        rgba = np.dstack([straight[..., ::-1], alpha])
        cv2.imwrite(str(path), (rgba * 255).round().clip(0, 255).astype(np.uint8))
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = camera.world_to_camera.T * [1, -1, -1], camera.centre
        frames[split].append({"file_path": f"./{split}/{path.stem}", "transform_matrix": matrix.tolist()})
    directions = random.normal(size=(STRAY, 3))
    stray = directions / np.linalg.norm(directions, axis=1, keepdims=True) * random.uniform(*SHELL, size=(STRAY, 1))
    write_points(
        root / "points.ply",
        np.concatenate([points, stray]),
        np.concatenate([colours, np.full((STRAY, 3), 0.5, np.float32)]),
    )
    facts = {"camera_angle_x": 2 * np.arctan(camera.width / 2 / camera.fx), "ply_file_path": "points.ply"}
    for split, views in frames.items():
        write_json(root / f"transforms_{split}.json", {**facts, "frames": views})
    return root
