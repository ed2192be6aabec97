"""What a photo file says about itself without being decoded: its size, its EXIF rotation, whether it is whole."""

import hashlib
import mmap
import os
import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from core.data.made import is_of_run, is_of_wegs
from core.errors import BadInput

cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what is wrong with a photo is said here, once

SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp", ".jp2", ".jfif", ".jpe")
# Of cameras and phones; OpenCV reads none, or as .avif in some builds only, and not turned as the file says. No photo is a .gif.
UNREADABLE_SUFFIXES = (".heic", ".heif", ".avif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf", ".gif", ".hif", ".jxl", ".pef", ".srw")

LEVELS = 3  # of folders in folders: phone scanners keep photos as deep as that
START_BYTES = 1 << 16  # of files that may be copies
JPEG_START = b"\xff\xd8"
JPEG_END = b"\xff\xd9"
JPEG_EXIF = b"Exif\0\0"
JPEG_SCAN, JPEG_APP1 = 0xDA, 0xE1
JPEG_FRAMES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # SOF0..SOF15 without DHT, JPG and DAC
PNG_START = b"\x89PNG\r\n\x1a\n"
EXIF_ORIENTATION = 0x0112
TRUNCATED = "ends before its picture does (truncated)"


@dataclass(frozen=True)
class Header:
    """Size in pixels as stored; orientation: EXIF's 1..8, where 5..8 swap width and height when displayed.

    exif: the EXIF block (a TIFF file in small), or empty.
    """

    kind: str  # "jpeg", "png", "webp" or "other"
    width: int
    height: int
    orientation: int = 1
    exif: bytes = b""

    @property
    def displayed(self) -> tuple[int, int]:
        """Width and height as displayed."""
        return (self.height, self.width) if self.orientation >= 5 else (self.width, self.height)


def list_photos(folder: Path) -> list[Path]:
    """The files in `folder` (not below) with a photo's suffix, by name. Hidden files are not photos."""
    return _list_files(folder, SUFFIXES)


def list_unreadable(folder: Path) -> list[Path]:
    """The files in `folder` in formats that cannot be read, by name."""
    return _list_files(folder, UNREADABLE_SUFFIXES)


def _list_files(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    files = (path for path in folder.iterdir() if path.suffix.lower() in suffixes and not path.name.startswith("."))
    return sorted((path for path in files if path.is_file()), key=lambda path: path.name)


def copies_among(paths: Iterable[Path]) -> dict[Path, Path]:
    """The files that are byte for byte as an earlier one of `paths`, with that one. Only what begins alike is read to its end."""
    copies = {}
    for same_size in _alike(paths, lambda path: path.stat().st_size):
        for same_start in _alike(same_size, lambda path: _digest(path, START_BYTES)):
            for original, *others in _alike(same_start, _digest):
                copies |= dict.fromkeys(others, original)
    return copies


def _alike(paths: Iterable[Path], key: Callable[[Path], object]) -> list[list[Path]]:
    """The files that share a key with others, in their order; what cannot be read is like no other."""
    groups: dict[object, list[Path]] = {}
    for path in paths:
        with suppress(OSError):  # who reads it will say so
            groups.setdefault(key(path), []).append(path)
    return [group for group in groups.values() if len(group) > 1]


def _digest(path: Path, count: int = -1) -> bytes:
    """Of the first `count` bytes of a file, or of all."""
    with path.open("rb") as file:
        return hashlib.sha256(file.read(count)).digest()


def no_photos(folder: Path, what: str = "no photos") -> BadInput:
    """The error for a folder that holds none, `what` in words: it says what is there instead."""
    if others := list_unreadable(folder):
        suffixes = ", ".join(sorted({path.suffix.lower() for path in others}))
        return BadInput(f"{folder} holds only {suffixes} photos, which cannot be read.", "Convert them to JPEG.")
    if is_of_run(folder):
        return BadInput(f"{folder} is a run, whose pictures are no photos.", "Give the folder that holds your photos.")
    if below := fuller_below(folder, folder):
        inner = below.relative_to(folder)
        return BadInput(f"{folder} holds {what}; there are photos in its folder {inner}.", "Name that folder, or put all photos into one.")
    return BadInput(f"{folder} holds {what}.", "Give the folder that holds your photos.")


def fuller_below(folder: Path, than: Path) -> Path | None:
    """The folder that holds the most photos of all up to LEVELS below `folder`, if it holds more than `than`; what wegs wrote does not count."""
    found = {path: len(list_photos(path)) for path in (than, *_folders_below(folder, LEVELS))}
    fullest = max(found, key=found.get)  # the first of equals
    return None if fullest == than else fullest


def _folders_below(folder: Path, levels: int) -> Iterator[Path]:
    """By name, each before those in it, without hidden ones and those of runs; what cannot be listed is skipped."""
    with suppress(OSError):
        for path in sorted(folder.iterdir()):
            if path.is_dir() and os.access(path, os.R_OK | os.X_OK) and not path.name.startswith(".") and not is_of_wegs(path):
                yield path
                if levels > 1:
                    yield from _folders_below(path, levels - 1)


def bad_photo(path: Path, why: str) -> BadInput:
    """The error for a photo that cannot be used."""
    return BadInput(f"{path} {why}.", "Copy it again, or convert it to JPEG or PNG.")


def named_with_fault(name: str, path: Path, problem: BadInput) -> str:
    """A photo for a list of those that cannot be used: its name, and in brackets what `problem` says of `path`."""
    return f"{name} ({problem.what.removeprefix(str(path)).removeprefix(name).strip(' .')})"


def probe(path: Path) -> Header:
    """The header of a photo. JPEG and PNG are not decoded; the few other formats are.

    Raises BadInput for a file that is missing, empty, truncated or no photo. OpenCV shows a truncated JPEG with its
    lower part grey and says nothing, so the end of the file is looked at here.
    """
    try:
        with open(path, "rb") as file:
            if not file.read(1):
                return read_header(path, b"")  # an empty file cannot be mapped
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                return read_header(path, data)
    except OSError as problem:
        raise bad_photo(path, f"cannot be opened ({problem.strerror})") from None


def read_header(path: Path, data: bytes | mmap.mmap) -> Header:
    """The header of a photo whose bytes are at hand; raises BadInput like `probe`."""
    header = peek(path, data)
    if header.width:
        return header
    turn = cv2.IMREAD_IGNORE_ORIENTATION if header.kind == "webp" else 0
    height, width = decode(path, data[:], cv2.IMREAD_COLOR | turn).shape[:2]
    return replace(header, width=width, height=height)


def peek(path: Path, data: bytes | mmap.mmap) -> Header:
    """As `read_header`, but nothing is decoded: width and height are 0 of what is neither a JPEG nor a PNG, whole or not."""
    if data[:2] == JPEG_START:
        return _read_jpeg(path, data)
    if data[:8] == PNG_START:
        return _read_png(path, data)
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return _read_webp(data)
    return Header("other", 0, 0)


def decode(path: Path, data: bytes, flags: int) -> np.ndarray:
    """OpenCV's picture of the file's bytes; raises BadInput where it has none."""
    if not data:
        raise bad_photo(path, "is empty")
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as problem:
        if problem.code == cv2.Error.StsNoMem:
            raise MemoryError from None
        pixels = None  # such as more than 2^30 pixels
    if pixels is None:
        raise bad_photo(path, "is not a photo that can be read")
    return pixels


def _read_jpeg(path: Path, data: bytes | mmap.mmap) -> Header:
    """Walk the segments to the first scan, then look for the end marker.

    Inside a scan FF is always followed by 00 or a restart marker, and thumbnails lie in segments before it, so FF D9
    after it is the end of the picture. More may follow: phones append depth maps and films.
    """
    position, size, exif, orientation = 2, None, b"", 1
    while True:
        segment = data[position : position + 4]
        if len(segment) < 4:
            raise bad_photo(path, TRUNCATED)
        marker = segment[1]
        if segment[0] != 0xFF or marker in (0x00, 0xFF):  # stray bytes or padding, which decoders skip
            position = data.find(b"\xff", position + 1)
            if position < 0:
                raise bad_photo(path, "is a broken JPEG")
            continue
        body, length = position + 4, int.from_bytes(segment[2:], "big")
        if marker in JPEG_FRAMES:
            height, width = struct.unpack(">HH", data[body + 1 : body + 5].ljust(4, b"\0"))
            size = (width, height)
        elif marker == JPEG_APP1 and not exif and data[body : body + 6] == JPEG_EXIF:
            exif = data[body + 6 : position + 2 + length]
            orientation = orientation_of(exif)
        elif marker == JPEG_SCAN:
            break
        position += 2 + length
    if size is None or 0 in size:
        raise bad_photo(path, "is a broken JPEG")
    if data.rfind(JPEG_END, position) < 0:
        raise bad_photo(path, TRUNCATED)
    return Header("jpeg", *size, orientation, exif)


def _read_png(path: Path, data: bytes | mmap.mmap) -> Header:
    """Walk the chunks to IEND."""
    position, size, exif, orientation = 8, (0, 0), b"", 1
    while True:
        head = data[position : position + 8]
        length = int.from_bytes(head[:4], "big")
        kind = head[4:]
        if len(head) < 8 or position + 12 + length > len(data):
            raise bad_photo(path, TRUNCATED)
        body = position + 8
        if kind == b"IHDR":
            size = struct.unpack(">II", data[body : body + 8].ljust(8, b"\0"))
        elif kind == b"eXIf":
            exif = data[body : body + length]
            orientation = orientation_of(exif)
        elif kind == b"IEND":
            break
        position += 12 + length
    if 0 in size:
        raise bad_photo(path, "is a broken PNG")
    return Header("png", *size, orientation, exif)


def _read_webp(data: bytes | mmap.mmap) -> Header:
    """Walk the chunks to EXIF."""
    position, exif = 12, b""
    while head := data[position : position + 8]:
        body, length = position + 8, int.from_bytes(head[4:], "little")
        if head[:4] == b"EXIF":
            exif = data[body : body + length].removeprefix(JPEG_EXIF)
            break
        position = body + length + length % 2
    return Header("webp", 0, 0, orientation_of(exif), exif)


def orientation_of(exif: bytes) -> int:
    """EXIF's orientation, 1..8; 1 where there is none or it is nonsense."""
    entry = _orientation_entry(exif)
    if entry is None:
        return 1
    offset, order = entry
    value = struct.unpack_from(order + "H", exif, offset)[0]
    return value if 1 <= value <= 8 else 1


def without_orientation(exif: bytes) -> bytes:
    """The EXIF block of a photo whose pixels have been turned upright; focal length and the rest stay."""
    entry = _orientation_entry(exif)
    if entry is None:
        return exif
    offset, order = entry
    return exif[:offset] + struct.pack(order + "H", 1) + exif[offset + 2 :]


def _orientation_entry(exif: bytes) -> tuple[int, str] | None:
    """Where the orientation's value lies in the EXIF block, and struct's byte order."""
    order = {b"II": "<", b"MM": ">"}.get(exif[:2])
    if order is None:
        return None
    try:
        first = struct.unpack_from(order + "I", exif, 4)[0]
        for index in range(struct.unpack_from(order + "H", exif, first)[0]):
            entry = first + 2 + 12 * index
            if struct.unpack_from(order + "H", exif, entry)[0] == EXIF_ORIENTATION and entry + 10 <= len(exif):
                return entry + 8, order
    except struct.error:  # cut short: as good as none
        return None
    return None
