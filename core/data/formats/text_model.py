"""Finds what is wrong with a COLMAP model in text, and in which line: pycolmap says neither.
The columns are those of COLMAP's format.rst."""

import math
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path

import pycolmap

from core.data.photos.distortion import MODELS
from core.words import counted

# The columns of each file. After them a camera has its parameters, a point its track, and an image a second line, of
# its features.
CAMERA = ("CAMERA_ID", "MODEL", "WIDTH", "HEIGHT")
IMAGE = ("IMAGE_ID", "QW", "QX", "QY", "QZ", "TX", "TY", "TZ", "CAMERA_ID", "NAME")
FEATURE = ("X", "Y", "POINT3D_ID")
POINT = ("POINT3D_ID", "X", "Y", "Z", "R", "G", "B", "ERROR")
FILES = {"cameras.txt": CAMERA, "images.txt": IMAGE, "points3D.txt": POINT}
WHOLE = {"CAMERA_ID", "WIDTH", "HEIGHT", "IMAGE_ID", "POINT3D_ID", "R", "G", "B"}
WORDS = {"MODEL", "NAME"}


class _BadLine(Exception):
    """What is wrong with a line, in words."""


def fault_in(folder: Path) -> str | None:
    """The first line of the model that cannot be read, and why; None if all can."""
    cameras: set[str] = set()
    for name, columns in FILES.items():
        if not (folder / name).is_file():
            continue
        met: set[str] = set()
        lines = enumerate((folder / name).read_text(encoding="utf-8-sig", errors="replace").split("\n"), 1)
        for number, line in lines:
            if not (words := line.split()) or words[0].startswith("#"):
                continue
            try:
                _check(columns, words)
                if words[0] in met:
                    raise _BadLine(f"{columns[0]} {words[0]} was there before")
                met.add(words[0])
                if columns == CAMERA:
                    _check_lens(words[1], words[len(CAMERA) :])
                    cameras.add(words[0])
                if columns == IMAGE:
                    if words[8] not in cameras:
                        raise _BadLine(f"its camera, {words[8]}, is not in cameras.txt")
                    number, line = next(lines, (number + 1, ""))
                    _check_features(line.split())
            except _BadLine as bad:
                return f"{folder / name} line {number}: {bad}"
    return None


def is_pose(line: str) -> bool:
    """Whether a line of an images.txt is the first of an image's two, and cannot be the second."""
    words = line.split()
    try:
        _check(IMAGE, words)
    except _BadLine:
        return False
    try:
        _check_features(words)
    except _BadLine:
        return True
    return False


def parameters_of(model: pycolmap.CameraModelId) -> int:
    """How many parameters a camera of this model has."""
    return len(pycolmap.Camera.create_from_model_id(1, model, 1.0, 2, 2).params)


def _check(columns: Sequence[str], words: Sequence[str]) -> None:
    for column, word in zip_longest(columns, words[: len(columns)]):
        if word is None:
            raise _BadLine(f"{column} is missing")
        if column not in WORDS and not _is_number(word, whole=column in WHOLE):
            raise _BadLine(f"{column} is {word!r}, not a {'whole ' if column in WHOLE else ''}number")


def _check_lens(model: str, params: Sequence[str]) -> None:
    if model not in MODELS:
        raise _BadLine(f"there is no camera model {model}")
    wanted = parameters_of(pycolmap.CameraModelId.__members__[model])
    if len(params) != wanted:
        raise _BadLine(f"{counted(len(params), 'parameter')}, not the {wanted} of a {model} camera")
    _check([f"parameter {number}" for number in range(1, wanted + 1)], params)


def _check_features(words: Sequence[str]) -> None:
    if len(words) % len(FEATURE):
        raise _BadLine(f"{counted(len(words), 'word')} in place of features of {' '.join(FEATURE)} each")
    for start in range(0, len(words), len(FEATURE)):
        _check(FEATURE, words[start : start + len(FEATURE)])


def _is_number(word: str, whole: bool) -> bool:
    try:
        return math.isfinite(int(word) if whole else float(word))
    except (ValueError, OverflowError):
        return False
