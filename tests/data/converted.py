"""COLMAP scenes written anew as other programs keep theirs,
so that every reader can be held against the reader of COLMAP models."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap

from core.data.formats.colmap import find_model
from core.data.formats.model_file import read_model

LENS_TERMS = {
    "SIMPLE_PINHOLE": (),
    "PINHOLE": (),
    "SIMPLE_RADIAL": ("k1",),
    "RADIAL": ("k1", "k2"),
    "OPENCV": ("k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4"),
}


# From a model's world to another one: scaled, turned about a slanted axis, and moved.
ELSEWHERE = pycolmap.Sim3d(2.5, pycolmap.Rotation3d(np.array([0.7, -1.1, 0.4])), np.array([30.0, -4.0, 7.0]))


def model_of(root: Path, world: pycolmap.Sim3d | None = None) -> pycolmap.Reconstruction:
    """The model below `root`, moved into another world."""
    model = read_model(find_model(root))
    if world:
        model.transform(world)
    return model


def images_of(root: Path, world: pycolmap.Sim3d | None = None) -> tuple[list[pycolmap.Image], Path]:
    """The posed images of the model below `root`, by name, and the folder that holds their photos."""
    images = sorted(model_of(root, world).images.values(), key=lambda image: image.name)
    folder = next(base / "images" for base in (root, root / "dense") if (base / "images").is_dir())
    return images, folder


def camera_to_world(image: pycolmap.Image) -> np.ndarray:
    """(4, 4), OpenCV axes."""
    matrix = np.eye(4)
    matrix[:3] = image.cam_from_world().inverse().matrix()
    return matrix


def frame_of(image: pycolmap.Image, file_path: str) -> dict:
    """The image as a frame of a transforms.json, with its own intrinsics."""
    lens = image.camera
    return {
        "file_path": file_path,
        "transform_matrix": (camera_to_world(image) * [1, -1, -1, 1]).tolist(),
        "camera_model": "OPENCV_FISHEYE" if lens.model_name == "OPENCV_FISHEYE" else "OPENCV",
        "w": lens.width,
        "h": lens.height,
        "fl_x": lens.focal_length_x,
        "fl_y": lens.focal_length_y,
        "cx": lens.principal_point_x,
        "cy": lens.principal_point_y,
        **dict(zip(LENS_TERMS[lens.model_name], lens.params[lens.extra_params_idxs()], strict=True)),
    }


def write_nerfstudio(
    colmap: Path, root: Path, points: str | None = "sparse_pc.ply", world: pycolmap.Sim3d | None = None, **facts
) -> Path:
    """transforms.json and images/ in `root`, which is returned; points: the .ply to write as well.
    facts: for the top of the file.

    world: from the model's world to that of the poses and the .ply.
    """
    images, folder = images_of(colmap, world)
    shutil.copytree(folder, root / "images")
    if points:
        write_ply(root / points, model_of(colmap, world))
        facts["ply_file_path"] = points
    write_json(
        root / "transforms.json", {**facts, "frames": [frame_of(image, f"images/{image.name}") for image in images]}
    )
    return root


def write_processed(colmap: Path, root: Path, **facts) -> Path:
    """What nerfstudio's ns-process-data leaves in `root`, which is returned:
    poses and .ply ELSEWHERE, the model in its own world."""
    shutil.copytree(find_model(colmap), root / "colmap" / "sparse" / "0")
    applied = np.c_[ELSEWHERE.rotation.matrix(), ELSEWHERE.translation / ELSEWHERE.scale].tolist()
    write_nerfstudio(
        colmap, root, world=ELSEWHERE, applied_transform=applied, applied_scale=float(ELSEWHERE.scale), **facts
    )
    ids = {f"images/{image.name}": image.image_id for image in images_of(colmap)[0]}
    return changed(
        root, lambda written: [frame.update(colmap_im_id=ids[frame["file_path"]]) for frame in written["frames"]]
    )


def write_blender(colmap: Path, root: Path, held_out: int = 4) -> Path:
    """transforms_train.json and transforms_test.json with train/ and test/; every `held_out`-th photo is a test photo.

    As Blender scenes do it gives the angle of view alone, so the lens has to be centred, with square pixels.
    """
    images, folder = images_of(colmap)
    for split in ("train", "test"):
        (root / split).mkdir(parents=True)
        frames = []
        for number, image in enumerate(images):
            if (number % held_out == 0) == (split == "test"):
                stem = Path(image.name).stem
                shutil.copy(folder / image.name, root / split / image.name)
                matrix = frame_of(image, "")["transform_matrix"]
                frames.append({"file_path": f"./{split}/{stem}", "rotation": 0.01, "transform_matrix": matrix})
        lens = images[0].camera
        angle = 2 * np.arctan(lens.width / 2 / lens.focal_length_x)
        write_json(root / f"transforms_{split}.json", {"camera_angle_x": angle, "frames": frames})
    return root


def write_nerf_osr(colmap: Path, root: Path, splits: dict[str, str]) -> Path:
    """final/SPLIT/{rgb,pose,intrinsics} in `root`; splits: photo name -> train, validation or test. Pinholes only."""
    images, folder = images_of(colmap)
    for image in images:
        place, lens = root / "final" / splits[image.name], image.camera
        for part in ("rgb", "pose", "intrinsics"):
            (place / part).mkdir(parents=True, exist_ok=True)
        shutil.copy(folder / image.name, place / "rgb" / image.name)
        intrinsics = np.eye(4)
        intrinsics[:3, :3] = lens.calibration_matrix()
        text = Path(image.name).with_suffix(".txt")
        for part, matrix in (("pose", camera_to_world(image)), ("intrinsics", intrinsics)):
            (place / part / text).write_text(" ".join(repr(float(number)) for number in matrix.ravel()) + "\n")
    return root


def write_ply(path: Path, model: pycolmap.Reconstruction) -> None:
    """The model's points, in text."""
    points = [model.points3D[number] for number in sorted(model.points3D)]
    header = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    header += [f"property double {axis}" for axis in "xyz"] + [
        f"property uchar {name}" for name in ("red", "green", "blue")
    ]
    rows = [" ".join([*(repr(float(x)) for x in point.xyz), *map(str, point.color)]) for point in points]
    path.write_text("\n".join([*header, "end_header", *rows]) + "\n")


def write_json(path: Path, facts: dict) -> None:
    path.write_text(json.dumps(facts))


def changed(root: Path, change: Callable[[dict], object]) -> Path:
    """The scene whose transforms.json went through `change`."""
    path = root / "transforms.json"
    facts = json.loads(path.read_text())
    change(facts)
    write_json(path, facts)
    return root
