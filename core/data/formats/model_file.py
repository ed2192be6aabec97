"""Reads a COLMAP model with pycolmap, after a check that its binary files are whole.

pycolmap 4.2 hangs on some truncated files and reads others as zeros, so each file is walked through first, record by
record.
"""

import os
import re
import shutil
import struct
import tempfile
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from core.data.formats.text_model import fault_in, is_pose, parameters_of
from core.errors import BadInput
from core.system.atomic import temporary_root

NEEDED, POINTS = ("cameras", "images"), "points3D"
SUFFIXES = (".bin", ".txt")  # of a model's two kinds of files, the first preferred
EMPTY_POINTS = {".bin": bytes(8), ".txt": b""}  # a file with no points
POSE_BYTES = 7 * 8  # quaternion and translation
# A point in a binary file. Its track follows: for each photo that sees it, the photo's id and the number of the
# feature.
POINT = np.dtype([("id", "<u8"), ("position", "<f8", 3), ("colour", "u1", 3), ("error", "<f8"), ("photos", "<u8")])
TRACK_COLUMN = 8  # of a point in text, after its id, place, colour and error
# Numbers in text that are not finite, in the spellings of various programs, or too large; and a replacement that
# pycolmap can read but that is no usable number. As it begins with a point, it is no valid id either.
NOT_FINITE, ENDLESS = re.compile(rb"(?i)(?<!\S)[+-]?(nan(\(\w*\))?|inf(inity)?|\d[\d.]*e\+?\d{3,})(?!\S)"), b".1e121"
REFUSALS = (ValueError, IndexError, RuntimeError)  # of pycolmap


@dataclass(frozen=True)
class PointTable:
    """The points of a model by ascending ids (P,), so that every run starts the same:
    positions (P, 3) float64, colours (P, 3) uint8.

    observers, observed: (N,) each, from the points' tracks: the id of an image, and the row of a point that it sees.
    """

    ids: np.ndarray
    positions: np.ndarray
    colours: np.ndarray
    observers: np.ndarray
    observed: np.ndarray


def holds_model(folder: Path) -> bool:
    """Whether `folder` has the files of a COLMAP model, binary or text; the file of points may be missing."""
    return any(_has(folder, suffix, *NEEDED) for suffix in SUFFIXES)


def photos_in_model(folder: Path) -> int:
    """How many photos the COLMAP model in `folder` has, without reading all of it; 0 if that fails."""
    with suppress(OSError, struct.error):
        if (binary := folder / "images.bin").is_file():
            with binary.open("rb") as file:
                return struct.unpack("<Q", file.read(8))[0]
        with (folder / "images.txt").open(encoding="utf-8-sig", errors="replace") as file:
            return sum(not line.startswith("#") for line in file) // 2  # a photo's pose, then its points
    return 0


def lacking_files(folder: Path) -> list[str]:
    """The files that are missing from an incomplete COLMAP model in `folder`;
    none if it is complete, or if there is none."""
    begun = [suffix for suffix in SUFFIXES if any(_has(folder, suffix, part) for part in (*NEEDED, POINTS))]
    lacking = ([part + suffix for part in NEEDED if not _has(folder, suffix, part)] for suffix in begun)
    return min(lacking, key=len, default=[])


def _has(folder: Path, suffix: str, *parts: str) -> bool:
    return all((folder / (part + suffix)).is_file() for part in parts)


def read_model(folder: Path) -> pycolmap.Reconstruction:
    """The model in `folder`, binary (preferred) or text, with or without points.

    Its rigs and frames are not read: the file of images has the same poses, and programs that change a model often
    change only that. If images and points do not agree, as after photos were removed by hand, the model is read without
    tracks (which say which photos see a point). Raises BadInput for files that are missing, truncated, damaged or not a
    model.
    """
    fix = "Copy the model again, or run COLMAP again."
    points = _points_file(folder)
    suffix = points.suffix if points else next((suffix for suffix in SUFFIXES if _has(folder, suffix, *NEEDED)), None)
    if suffix is None:
        raise BadInput(f"The COLMAP model in {folder} lacks {', '.join(lacking_files(folder))}.", fix)
    names = {}
    if suffix == ".txt":
        names = _names_with_spaces(folder / "images.txt")
    else:
        for part, end_of_record in RECORDS.items():
            file = folder / f"{part}.bin"
            if file.is_file() and not _whole(file.read_bytes(), end_of_record):
                raise BadInput(f"{file} is truncated or damaged.", fix)
    try:
        with quiet():
            model = _read(folder, suffix, points)
            for number, name in names.items():
                model.image(number).name = name
            return model
    except REFUSALS as problem:
        if suffix == ".txt" and (fault := fault_in(folder)):
            raise BadInput(f"{fault}.", "Correct it, copy the model again, or run COLMAP again.") from None
        reason = str(problem).strip().partition("\n")[0]
        raise BadInput(f"{folder} is not a COLMAP model that can be read ({reason}).", fix) from None


def point_table(model: pycolmap.Reconstruction, folder: Path) -> PointTable:
    """The points of the model that `read_model` read from this folder.
    A binary file is read again: pycolmap gives access to one point at a time."""
    file = _points_file(folder)
    if file is not None and file.suffix == ".bin":
        has_tracks = any(point.track.length() for point in model.points3D.values())
        points, observers = _points_and_observers(file.read_bytes() if has_tracks else _without_tracks(file))
    else:
        rows = [
            (number, point.xyz, point.color, point.error, point.track.length())
            for number, point in model.points3D.items()
        ]
        points = np.array(rows, POINT)
        observers = np.array(
            [element.image_id for point in model.points3D.values() for element in point.track.elements], np.uint32
        )
    order = np.argsort(points["id"])
    row_of = np.empty_like(order)
    row_of[order] = np.arange(len(order))
    observed = np.repeat(row_of, points["photos"].astype(np.int64))
    ids, positions, colours = (points[field][order] for field in ("id", "position", "colour"))
    return PointTable(ids, positions, colours, observers, observed)


def _points_file(folder: Path) -> Path | None:
    """The file of points, if the model has all files of its kind."""
    return next((folder / (POINTS + suffix) for suffix in SUFFIXES if _has(folder, suffix, *NEEDED, POINTS)), None)


def _read(folder: Path, suffix: str, points: Path | None) -> pycolmap.Reconstruction:
    """The model of the files in `folder` with this suffix.
    If pycolmap refuses them, text is tried again `_mended`, then either without tracks.

    The files are read from a temporary folder: pycolmap demands all three, and reads whatever else lies beside them.
    """
    with tempfile.TemporaryDirectory(dir=temporary_root()) as temporary:
        files = [Path(temporary, part + suffix) for part in (*NEEDED, POINTS)]
        for file in files:
            if file.stem == POINTS and points is None:
                file.write_bytes(EMPTY_POINTS[suffix])
            else:
                _put_into(temporary, folder / file.name)
        with suppress(*REFUSALS):
            return pycolmap.Reconstruction(temporary)
        if suffix == ".txt":
            for file in files:
                _replace(file, _mended(file.read_bytes()))
            with suppress(*REFUSALS):
                return pycolmap.Reconstruction(temporary)
        _replace(files[-1], _without_tracks(files[-1]))
        return pycolmap.Reconstruction(temporary)


def _put_into(folder: str, file: Path) -> None:
    """Put a file of a model into another folder: a link, or a copy where there can be none."""
    try:
        os.symlink(file.resolve(), Path(folder, file.name))
    except OSError:  # Windows lets few users do so
        shutil.copyfile(file, Path(folder, file.name))


def _replace(link: Path, content: bytes) -> None:
    """Replace a link by a file, leaving alone what the link points to."""
    link.unlink()
    link.write_bytes(content)


def _mended(text: bytes) -> bytes:
    """A text that pycolmap reads like the same model in binary: without the byte-order mark that Windows programs
    write, and with ENDLESS for numbers that are not finite, which then spoil only their own point or photos."""
    return NOT_FINITE.sub(ENDLESS, text.removeprefix(BOM_UTF8))


def _names_with_spaces(path: Path) -> dict[int, str]:
    """The names with spaces in an images.txt, by image id: pycolmap would read only their first words. Raises BadInput
    if an image has one line in place of two: pycolmap would skip every other image."""
    names = {}
    with open(path, encoding="utf-8-sig", errors="replace") as file:
        for line in file:
            words = line.split(maxsplit=9)
            if len(words) < 10 or not words[0].isdecimal():
                continue
            name, features = words[9].strip(), next(file, None)
            if features is None or is_pose(features):
                raise BadInput(
                    f"{path} gives {name} one line in place of two.",
                    "Add the line of its features after it, which may be empty.",
                )
            if " " in name:
                names[int(words[0])] = name
    return names


def _without_tracks(path: Path) -> bytes:
    """The content of a whole file of points, without their tracks."""
    data = path.read_bytes()
    if path.suffix == ".txt":
        return b"\n".join(b" ".join(line.split()[:TRACK_COLUMN]) for line in data.splitlines())
    points, _ = _points_and_observers(data)
    points["photos"] = 0
    return data[:8] + points.tobytes()


def _points_and_observers(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """The points (P,), each a POINT, in a whole binary file of them, and the image ids (N,) of their tracks,
    one track after the other."""
    points, tracks, start = bytearray(), bytearray(), 8
    while start < len(data):
        track, end = start + POINT.itemsize, _end_of_point(data, start)
        points += data[start:track]
        tracks += data[track:end]
        start = end
    return np.frombuffer(points, POINT), np.frombuffer(tracks, "<u4")[::2]


@contextmanager
def quiet() -> Iterator[None]:
    """Within the block, pycolmap logs only fatal errors. Its log level, which is global, is restored afterwards."""
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before


def _whole(data: bytes, end_of_record: Callable[[bytes, int], int]) -> bool:
    """Whether the records that the file's header counts fill it exactly."""
    try:
        count = _integer(data, 0, "Q")
        position = 8
        for _ in range(count):
            position = end_of_record(data, position)
        return position == len(data)
    except (struct.error, ValueError, OverflowError):
        return False


# Where the record ends that begins at `start` (COLMAP's format.rst).


def _end_of_camera(data: bytes, start: int) -> int:
    model = pycolmap.CameraModelId(_integer(data, start + 4, "i"))
    return start + 24 + 8 * parameters_of(model)


def _end_of_image(data: bytes, start: int) -> int:
    name = start + 4 + POSE_BYTES + 4
    end = data.index(b"\0", name) + 1
    return end + 8 + 24 * _integer(data, end, "Q")


def _end_of_point(data: bytes, start: int) -> int:
    track = start + POINT.itemsize
    return track + 8 * _integer(data, track - 8, "Q")


def _integer(data: bytes, position: int, kind: str) -> int:
    return struct.unpack_from("<" + kind, data, position)[0]


# Of the files of a binary model.
RECORDS = {"cameras": _end_of_camera, "images": _end_of_image, "points3D": _end_of_point}
