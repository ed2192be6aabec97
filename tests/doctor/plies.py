"""A .ply as another program would write it, cameras beside it, and what keeps them from being drawn."""

import json

import numpy as np
import plyfile

from core.errors import BadInput

ROWS = 400


def columns(rest: int = 45) -> list[str]:
    """Of a 3DGS .ply as other programs write it: any order, no normals, a column of their own."""
    names = [*(f"rot_{i}" for i in range(4)), *(f"scale_{i}" for i in range(3)), "opacity", "x", "y", "z", "segment"]
    return [*names, *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(rest))]


def sound_rows(rest: int = 45, kind: str = "<f4") -> np.ndarray:
    """Small round grey Gaussians, half transparent, in a ball of radius 1."""
    random = np.random.default_rng(0)
    rows = np.zeros(ROWS, dtype=[(name, kind) for name in columns(rest)])
    places = random.normal(size=(ROWS, 3))
    places *= random.random((ROWS, 1)) / np.linalg.norm(places, axis=1, keepdims=True)
    for axis, name in enumerate("xyz"):
        rows[name] = places[:, axis]
    for axis in range(3):
        rows[f"scale_{axis}"] = np.log(0.01)
    rows["rot_0"] = 1
    return rows


def write(path, rows, comment=""):
    comments = [comment] if comment else []
    plyfile.PlyData([plyfile.PlyElement.describe(rows, "vertex", comments=comments)]).write(str(path))
    return path


def cameras_json(*positions) -> str:
    """Cameras of the original project at these places, looking along z."""
    lens = {"width": 64, "height": 48, "fx": 50.0, "fy": 50.0}
    return json.dumps([{"position": list(p), "rotation": np.eye(3).tolist(), **lens} for p in positions])


def refuse(*_):
    """In place of what draws Gaussians."""
    raise BadInput("400 Gaussians cover 1e9 tiles.", "Lower the resolution (-r).")
