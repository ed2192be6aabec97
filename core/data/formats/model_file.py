"""Reading a COLMAP model with pycolmap, after a check that its binary files are whole.

pycolmap 4.2 never returns from some truncated files and reads others as zeros, so each file is walked first, record by
record.
"""

import shutil
import struct
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pycolmap

from core.errors import BadInput

NEEDED, POINTS = ("cameras", "images"), "points3D"
SUFFIXES = (".bin", ".txt")  # of a model's two kinds of files, the first preferred
EMPTY_POINTS = {".bin": bytes(8), ".txt": b""}  # a file with no points
POSE_BYTES = 7 * 8  # quaternion and translation
TRACK_BYTE, TRACK_COLUMN = 8 + 24 + 3 + 8, 8  # of a point, after its id, place, colour and error
REFUSALS = (ValueError, IndexError, RuntimeError)  # of pycolmap


def holds_model(folder: Path) -> bool:
    """Whether `folder` has the files of a COLMAP model, binary or text; the file of points may be missing."""
    return any(_has(folder, suffix, *NEEDED) for suffix in SUFFIXES)


def photos_in_model(folder: Path) -> int:
    """How many photos the COLMAP model in `folder` has, by the head of its file of photos; none if that cannot be read."""
    with suppress(OSError, struct.error):
        if (binary := folder / "images.bin").is_file():
            with binary.open("rb") as file:
                return struct.unpack("<Q", file.read(8))[0]
        with (folder / "images.txt").open(encoding="utf-8", errors="replace") as file:
            return sum(not line.startswith("#") for line in file) // 2  # a photo's pose, then its points
    return 0


def lacking_files(folder: Path) -> list[str]:
    """The files that are missing from a COLMAP model of which `folder` has a part; none if it has all of it, or nothing."""
    begun = [suffix for suffix in SUFFIXES if any(_has(folder, suffix, part) for part in (*NEEDED, POINTS))]
    lacking = ([part + suffix for part in NEEDED if not _has(folder, suffix, part)] for suffix in begun)
    return min(lacking, key=len, default=[])


def _has(folder: Path, suffix: str, *parts: str) -> bool:
    return all((folder / (part + suffix)).is_file() for part in parts)


def read_model(folder: Path) -> pycolmap.Reconstruction:
    """The model in `folder`, binary (preferred) or text, with or without rigs, frames and points.

    If its parts do not agree, as after photos were removed by hand, it is read without rigs, frames and tracks (which photos see a
    point). Raises BadInput for files that are truncated, damaged or not a model.
    """
    fix = "Copy the model again, or run COLMAP again."
    whole = next((suffix for suffix in SUFFIXES if _has(folder, suffix, *NEEDED, POINTS)), None)
    suffix = whole or next((suffix for suffix in SUFFIXES if _has(folder, suffix, *NEEDED)), None)
    for part, walk in WALKS.items() if suffix == ".bin" else ():
        file = folder / f"{part}.bin"
        if file.is_file() and not _whole(file.read_bytes(), walk):
            raise BadInput(f"{file} is truncated or damaged.", fix)
    names = _names_with_spaces(folder / "images.txt") if suffix == ".txt" else {}
    try:
        with quiet():
            model = _read(folder, suffix, bool(whole))
            for number, name in names.items():
                model.image(number).name = name
            return model
    except REFUSALS as problem:
        reason = str(problem).strip().splitlines()[0] if str(problem).strip() else type(problem).__name__
        raise BadInput(f"{folder} is not a COLMAP model that can be read ({reason}).", fix) from None


def _read(folder: Path, suffix: str | None, whole: bool) -> pycolmap.Reconstruction:
    if suffix and not whole:
        return _read_parts(folder, suffix, WALKS, EMPTY_POINTS[suffix])
    try:
        return pycolmap.Reconstruction(str(folder))
    except REFUSALS:
        if not whole:
            raise
        return _read_parts(folder, suffix, NEEDED, _without_tracks(folder / (POINTS + suffix)))


def _names_with_spaces(path: Path) -> dict[int, str]:
    """The names with spaces in an images.txt, by image id: pycolmap would read only their first words. BadInput if an image has one line,
    not two: pycolmap would skip every other image."""
    names = {}
    with open(path, encoding="utf-8", errors="replace") as file:
        for line in file:
            words = line.split(maxsplit=9)
            if len(words) < 10 or not words[0].isdecimal():
                continue
            name, features = words[9].strip(), next(file, "").strip()
            if features[-1:].isalpha():  # of the next name; features end in numbers
                raise BadInput(f"{path} gives {name} one line in place of two.", "Add the line of its features after it, which may be empty.")
            if " " in name:
                names[int(words[0])] = name
    return names


def _read_parts(folder: Path, suffix: str, parts: Iterable[str], points: bytes) -> pycolmap.Reconstruction:
    """The model read from those of these `parts` that exist, with `points` as its file of points, which pycolmap insists on."""
    with tempfile.TemporaryDirectory() as copy:
        for part in parts:
            if _has(folder, suffix, part):
                shutil.copyfile(folder / (part + suffix), Path(copy, part + suffix))
        Path(copy, POINTS + suffix).write_bytes(points)
        return pycolmap.Reconstruction(copy)


def _without_tracks(path: Path) -> bytes:
    """The content of a whole file of points, without their tracks."""
    data = path.read_bytes()
    if path.suffix == ".txt":
        return b"\n".join(b" ".join(line.split()[:TRACK_COLUMN]) for line in data.splitlines())
    rows, start = [data[:8]], 8
    while start < len(data):
        rows += data[start : start + TRACK_BYTE], bytes(8)
        start = _point(data, start)
    return b"".join(rows)


@contextmanager
def quiet() -> Iterator[None]:
    """Inside, pycolmap logs only fatal errors. Its log level is global, so it is restored afterwards."""
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before


def _whole(data: bytes, walk: Callable[[bytes, int], int]) -> bool:
    """Whether the records that the file's header counts fill it exactly."""
    try:
        count = _integer(data, 0, "Q")
        position = 8
        for _ in range(count):
            position = walk(data, position)
        return position == len(data)
    except (struct.error, ValueError, KeyError):
        return False


# Each walk gets the start of a record and returns its end (COLMAP's format.rst).


def _camera(data: bytes, start: int) -> int:
    model = pycolmap.CameraModelId(_integer(data, start + 4, "i"))
    return start + 24 + 8 * len(pycolmap.Camera.create_from_model_id(1, model, 1.0, 2, 2).params)


def _image(data: bytes, start: int) -> int:
    name = start + 4 + POSE_BYTES + 4
    end = data.index(b"\0", name) + 1
    return end + 8 + 24 * _integer(data, end, "Q")


def _point(data: bytes, start: int) -> int:
    track = start + TRACK_BYTE
    return track + 8 + 8 * _integer(data, track, "Q")


def _rig(data: bytes, start: int) -> int:
    sensors = _integer(data, start + 4, "I")
    position = start + 8 + (8 if sensors else 0)  # the reference sensor has no pose
    for _ in range(max(sensors - 1, 0)):
        position += 9 + (POSE_BYTES if _integer(data, position + 8, "B") else 0)
    return position


def _frame(data: bytes, start: int) -> int:
    ids = start + 8 + POSE_BYTES
    return ids + 4 + 16 * _integer(data, ids, "I")


def _integer(data: bytes, position: int, kind: str) -> int:
    return struct.unpack_from("<" + kind, data, position)[0]


WALKS = {"cameras": _camera, "images": _image, "points3D": _point, "rigs": _rig, "frames": _frame}
