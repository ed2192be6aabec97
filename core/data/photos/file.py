"""What a photo file says about itself without being decoded: its size, its EXIF rotation, whether it is whole."""

import mmap
import struct
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from core.data.photos.heif import FAULTS, decode_heif, is_heif, is_whole, size_and_exif
from core.errors import BadInput

cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what is wrong with a photo is said here, once

UNKNOWN = "is not a photo that can be read"
JPEG_START = b"\xff\xd8"
JPEG_END = b"\xff\xd9"
JPEG_EXIF = b"Exif\0\0"
JPEG_SCAN, JPEG_APP1 = 0xDA, 0xE1
JPEG_FRAMES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # SOF0..SOF15 without DHT, JPG and DAC
PNG_START = b"\x89PNG\r\n\x1a\n"
TIFF_STARTS = (b"II*\0", b"MM\0*")
# Tags of a TIFF file, which an EXIF block is, too. Its picture lies in strips or in tiles.
WIDTH, HEIGHT, COMPRESSION, ORIENTATION, EXTRA_SAMPLES, SAMPLE_FORMAT = 256, 257, 259, 274, 338, 339
STRIP_STARTS, STRIP_BYTES, TILE_STARTS, TILE_BYTES = 273, 279, 324, 325
TIFF_INTEGERS = {3: "H", 4: "I"}  # types of numbers
COMPRESSIONS = {1, 5, 7, 8, 32773, 32946}  # none, LZW, JPEG, deflate, PackBits, deflate by its older number: OpenCV decodes these
WHOLE_NUMBERS = 1  # a SAMPLE_FORMAT
MULTIPLIED, STRAIGHT = (1,), (2,)  # EXTRA_SAMPLES of a picture whose colours are multiplied by its alpha, and of one whose colours are not
TRUNCATED = "ends before its picture does (truncated)"


@dataclass(frozen=True)
class Header:
    """Size in pixels as stored. orientation: EXIF's, 1..8.

    exif: the EXIF block (a small TIFF file), or empty.
    """

    kind: str  # "jpeg", "png", "webp", "heif" or "other"
    width: int
    height: int
    orientation: int = 1
    exif: bytes = b""

    @property
    def displayed(self) -> tuple[int, int]:
        """Width and height as displayed."""
        return (self.height, self.width) if swaps_sides(self.orientation) else (self.width, self.height)


def swaps_sides(orientation: int) -> bool:
    """Whether a photo of this EXIF orientation, 1..8, is displayed with width and height swapped."""
    return orientation >= 5


def bad_photo(path: Path, why: str) -> BadInput:
    """The error for a photo that cannot be used."""
    return BadInput(f"{path} {why}.", "Copy it again, or convert it to JPEG or PNG.")


def fault_of(name: str, path: Path, problem: BadInput) -> str:
    """What `problem` says about the photo of this name, or about its file, without naming either."""
    return problem.what.removeprefix(str(path)).removeprefix(name).strip(" .")


def named_with_fault(name: str, path: Path, problem: BadInput) -> str:
    """A photo in a list of unusable ones: its name, and its fault in brackets."""
    return f"{name} ({fault_of(name, path, problem)})"


def probe(path: Path) -> Header:
    """The header of a photo. JPEG, PNG, WebP, HEIF and usual TIFF are not decoded; the few other formats are.

    Raises BadInput for a file that is missing, empty, truncated or not a photo. OpenCV decodes a truncated JPEG with its lower part grey
    and reports nothing, so the end of the file is checked here.
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
    """The header of a photo from its bytes; raises BadInput like `probe`."""
    header = peek(path, data)
    if header.width:
        return header
    height, width = decode(path, data[:], cv2.IMREAD_COLOR).shape[:2]
    return replace(header, width=width, height=height)


def peek(path: Path, data: bytes | mmap.mmap) -> Header:
    """As `read_header`, but nothing is decoded. Where that would be needed, width and height are 0, and it is not checked that the file is whole."""
    if data[:2] == JPEG_START:
        return _read_jpeg(path, data)
    if data[:8] == PNG_START:
        return _read_png(path, data)
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return _read_webp(path, data)
    if is_heif(data):
        return _read_heif(path, data[:])
    if data[:4] in TIFF_STARTS:
        return _read_tiff(data)
    return Header("other", 0, 0)


def decode(path: Path, data: bytes, flags: int) -> np.ndarray:
    """The file's bytes decoded by OpenCV, with its `flags`, or as `decode_heif`, without; raises BadInput if that cannot be done."""
    if not data:
        raise bad_photo(path, "is empty")
    try:
        pixels = decode_heif(data) if is_heif(data) else cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except FAULTS:
        pixels = None
    except cv2.error as problem:
        if problem.code == cv2.Error.StsNoMem:
            raise
        pixels = None  # such as more than 2^30 pixels
    if pixels is None:
        raise bad_photo(path, UNKNOWN)
    return pixels


def multiplied_by_alpha(data: bytes, depth: int) -> bool:
    """Whether `decode` returns the colours of a file multiplied by its alpha, as of some TIFFs: OpenCV does so to those of 8 bits. depth: bits."""
    if data[:4] in TIFF_STARTS:
        with suppress(struct.error, LookupError):  # of a broken file
            return _tiff_numbers(data, EXTRA_SAMPLES) in ((MULTIPLIED, STRAIGHT) if depth == 8 else (MULTIPLIED,))
    return False


def _read_jpeg(path: Path, data: bytes | mmap.mmap) -> Header:
    """Walk the segments to the first scan, then look for the end marker.

    Inside a scan FF is always followed by 00 or a restart marker, and thumbnails lie in segments before the scan, so an FF D9 after its
    start is the end of the picture. More may follow: phones append depth maps and films.
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


def _read_webp(path: Path, data: bytes | mmap.mmap) -> Header:
    """Walk the chunks to EXIF."""
    if 8 + int.from_bytes(data[4:8], "little") > len(data):
        raise bad_photo(path, TRUNCATED)
    position, size, exif = 12, None, b""
    while head := data[position : position + 8]:
        body, length = position + 8, int.from_bytes(head[4:], "little")
        size = size or _webp_size(head[:4], data[body : body + 10].ljust(10, b"\0"))
        if head[:4] == b"EXIF":
            exif = data[body : body + length].removeprefix(JPEG_EXIF)
            break
        position = body + length + length % 2
    if size is None or 0 in size:
        raise bad_photo(path, "is a broken WebP")
    return Header("webp", *size, orientation_of(exif), exif)


def _webp_size(kind: bytes, body: bytes) -> tuple[int, int] | None:
    """Width and height as a chunk of this kind states them in its first 10 bytes; None for one that does not."""
    if kind == b"VP8X":
        return 1 + int.from_bytes(body[4:7], "little"), 1 + int.from_bytes(body[7:10], "little")
    if kind == b"VP8L":
        sides = int.from_bytes(body[1:5], "little")
        return 1 + (sides & 0x3FFF), 1 + (sides >> 14 & 0x3FFF)
    if kind == b"VP8 ":
        width, height = struct.unpack("<HH", body[6:10])
        return width & 0x3FFF, height & 0x3FFF  # the upper bits are for display
    return None


def _read_heif(path: Path, data: bytes) -> Header:
    if not is_whole(data):
        raise bad_photo(path, TRUNCATED)
    try:
        size, exif = size_and_exif(data)
    except FAULTS:
        raise bad_photo(path, UNKNOWN) from None
    return Header("heif", *size, exif=without_orientation(exif.removeprefix(JPEG_EXIF)))


def _read_tiff(data: bytes | mmap.mmap) -> Header:
    """The size as displayed, because OpenCV applies the rotation; 0 where only decoding tells whether the file can be used."""
    with suppress(struct.error, LookupError, ValueError):  # of a broken file
        (width,), (height,) = _tiff_numbers(data, WIDTH), _tiff_numbers(data, HEIGHT)
        starts = _tiff_numbers(data, STRIP_STARTS) or _tiff_numbers(data, TILE_STARTS)
        lengths = _tiff_numbers(data, STRIP_BYTES) or _tiff_numbers(data, TILE_BYTES)
        whole = starts and all(start + length <= len(data) for start, length in zip(starts, lengths, strict=True))
        usual = COMPRESSIONS.issuperset(_tiff_numbers(data, COMPRESSION)) and {WHOLE_NUMBERS}.issuperset(_tiff_numbers(data, SAMPLE_FORMAT))
        if whole and usual and width and height:
            return Header("other", *((height, width) if swaps_sides(orientation_of(data)) else (width, height)))
    return Header("other", 0, 0)


def _tiff_numbers(tiff: bytes | mmap.mmap, tag: int) -> tuple[int, ...]:
    """The whole numbers that a tag of a TIFF file has; none if it is not there. Raises struct.error or LookupError for a broken file."""
    found = _tiff_entry(tiff, tag)
    if found is None:
        return ()
    entry, order = found
    kind, count = struct.unpack_from(order + "HI", tiff, entry + 2)
    layout = f"{order}{count}{TIFF_INTEGERS[kind]}"
    place = entry + 8
    if struct.calcsize(layout) > 4:
        place = struct.unpack_from(order + "I", tiff, place)[0]
    return struct.unpack_from(layout, tiff, place)


def orientation_of(exif: bytes | mmap.mmap) -> int:
    """EXIF's orientation, 1..8; 1 if there is none or it is out of range."""
    found = _tiff_entry(exif, ORIENTATION)
    if found is None:
        return 1
    entry, order = found
    value = struct.unpack_from(order + "H", exif, entry + 8)[0]
    return value if 1 <= value <= 8 else 1


def without_orientation(exif: bytes) -> bytes:
    """The EXIF block of a photo whose pixels have been turned upright; focal length and the rest stay."""
    found = _tiff_entry(exif, ORIENTATION)
    if found is None:
        return exif
    entry, order = found
    return exif[: entry + 8] + struct.pack(order + "H", 1) + exif[entry + 10 :]


def _tiff_entry(tiff: bytes | mmap.mmap, tag: int) -> tuple[int, str] | None:
    """Where the tag's entry begins in the first directory of a TIFF file, and the byte order as struct writes it; None if there is none."""
    order = {b"II": "<", b"MM": ">"}.get(tiff[:2])
    if order is None:
        return None
    with suppress(struct.error):  # cut short: as good as none
        first = struct.unpack_from(order + "I", tiff, 4)[0]
        for index in range(struct.unpack_from(order + "H", tiff, first)[0]):
            entry = first + 2 + 12 * index
            if struct.unpack_from(order + "H", tiff, entry)[0] == tag and entry + 10 <= len(tiff):
                return entry, order
    return None
