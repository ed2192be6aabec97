"""What a photo file says about itself without being decoded:
its size, its EXIF rotation, its colour profile, whether it is whole."""

import logging
import mmap
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from io import BytesIO
from itertools import chain, product
from pathlib import Path

from PIL import Image, ImageChops, ImageCms
from PIL.TiffImagePlugin import (
    BITSPERSAMPLE,
    COMPRESSION,
    PHOTOMETRIC_INTERPRETATION,
    PLANAR_CONFIGURATION,
    STRIPBYTECOUNTS,
    STRIPOFFSETS,
    TILEBYTECOUNTS,
    TILEOFFSETS,
    TiffImageFile,
)

from core.errors import BadInput

Image.MAX_IMAGE_PIXELS = 1 << 29  # more than twice that are an attack to Pillow, whose own limit is a sixth of it
warnings.filterwarnings("ignore", module=r"PIL\.")  # what is wrong with a photo is said here, once
logging.getLogger("PIL").setLevel(logging.CRITICAL)

# Those of Pillow's formats that photos have. Others are not recognised by their first bytes, or run a program, as EPS
# does.
FORMATS, FORMATS_IN_BOXES = ("JPEG", "PNG", "WEBP", "TIFF", "BMP", "JPEG2000", "GIF", "PPM"), ("HEIF", "AVIF")
UNKNOWN = "is not a photo that can be read"
TRUNCATED = "ends before its picture does (truncated)"
# What Pillow's decoders raise for a file that is damaged or coded in another way.
FAULTS = (
    OSError,
    ValueError,
    LookupError,
    EOFError,
    SyntaxError,
    RuntimeError,
    TypeError,
    struct.error,
    Image.DecompressionBombError,
)
SCAN, END = b"\xff\xda", b"\xff\xd9"  # markers of a JPEG
BOXES = (b"ftyp", b"meta", b"mdat", b"free", b"skip", b"moov")
LONG = b"\0\0\0\1"  # in place of a box's size, which then follows
ORIENTATION = 0x0112  # EXIF's tag
COLOURS = Image.frombytes("RGB", (6**3, 1), bytes(chain(*product(range(0, 256, 51), repeat=3))))  # all over the cube
UNSEEN = 2  # 8-bit steps by which a colour may be off
MOST_EXIF_BYTES = 0xFFFF - 2  # of a JPEG


@dataclass(frozen=True)
class Header:
    """Size in pixels as stored. kind: Pillow's name of the format. orientation: EXIF's, 1..8.

    exif: the EXIF block, or empty. profile: the ICC profile of its colours, or empty where they are taken for sRGB.
    """

    kind: str
    width: int
    height: int
    orientation: int = 1
    exif: bytes = b""
    profile: bytes = b""

    @property
    def displayed(self) -> tuple[int, int]:
        """Width and height as displayed."""
        return (self.height, self.width) if swaps_sides(self.orientation) else (self.width, self.height)

    @property
    def is_jpeg(self) -> bool:
        return self.kind in ("JPEG", "MPO")  # MPO: other pictures follow


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
    """The header of a photo. In formats whose structure does not show whether a file is whole,
    the picture is decoded, too.

    Raises BadInput for a file that is missing, empty, truncated or not a photo.
    """
    with opened(path) as (header, picture):
        if header.kind not in IS_WHOLE:
            picture.load()
    return header


@contextmanager
def opened(path: Path) -> Iterator[tuple[Header, Image.Image]]:
    """The header of a photo file and its picture, not decoded yet;
    whatever decoding raises in the block becomes BadInput.

    Raises BadInput like `probe`: a truncated JPEG would be decoded with its lower part grey, and a truncated HEIF might
    end the program.
    """
    try:
        with open(path, "rb") as file:
            if not file.read(1):
                raise bad_photo(path, "is empty")  # and cannot be mapped
            file.seek(0)
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                in_boxes = data[4:8] == BOXES[0]
                if in_boxes:
                    _know_heif()
                with Image.open(file, formats=FORMATS_IN_BOXES if in_boxes else FORMATS) as picture:
                    if _is_misread(picture):
                        raise bad_photo(path, UNKNOWN)
                    if picture.format in IS_WHOLE and not IS_WHOLE[picture.format](data, picture):
                        raise bad_photo(path, TRUNCATED)
                    yield _header(data, picture), picture
    except FAULTS as problem:
        if isinstance(problem, OSError) and problem.strerror:
            raise bad_photo(path, f"cannot be opened ({problem.strerror})") from None
        raise bad_photo(path, TRUNCATED if "truncated" in str(problem).lower() else UNKNOWN) from None


@cache
def _know_heif() -> None:
    from pi_heif import register_heif_opener  # late: few collections have such photos

    register_heif_opener()


def _is_misread(picture: Image.Image) -> bool:
    """Whether Pillow would misread the brightness: with more than 16 bits a channel, and in some TIFFs of 16 bits."""
    if picture.mode in ("I", "F"):
        return True
    if not isinstance(picture, TiffImageFile) or 16 not in picture.tag_v2.get(BITSPERSAMPLE, ()):
        return False
    channels_apart = picture.tag_v2.get(PLANAR_CONFIGURATION) == 2 and picture.tag_v2.get(COMPRESSION, 1) == 1
    return channels_apart or picture.tag_v2.get(PHOTOMETRIC_INTERPRETATION) == 0  # 0 is white


def _header(data: mmap.mmap, picture: Image.Image) -> Header:
    """Pillow turns HEIF and TIFF upright when it decodes them,
    and reports the size of a TIFF as displayed even before that."""
    if isinstance(picture, TiffImageFile):
        size = picture.size[::-1] if swaps_sides(picture.tag_v2.get(ORIENTATION, 1)) else picture.size
        return Header("TIFF", *size, _orientation(picture.getexif()), b"", _profile(picture))
    exif = picture.info.get("exif", b"")
    if picture.format == "PNG" and not exif:
        exif = _exif_at_the_end(data)
    return Header(str(picture.format), *picture.size, _orientation(tags_of(exif)), exif, _profile(picture))


def _orientation(tags: Image.Exif) -> int:
    found = tags.get(ORIENTATION, 1)
    return found if found in range(1, 9) else 1


def _exif_at_the_end(png: mmap.mmap) -> bytes:
    """The EXIF block that some programs write behind the picture, where Pillow finds it only after decoding."""
    kind = png.rfind(b"eXIf", -MOST_EXIF_BYTES)
    return png[kind + 4 : kind + 4 + int.from_bytes(png[kind - 4 : kind], "big")] if kind >= 0 else b""


def tags_of(exif: bytes) -> Image.Exif:
    """The tags of an EXIF block; none of a broken one."""
    tags = Image.Exif()
    with suppress(*FAULTS):
        tags.load(exif)
    return tags


def upright_exif(exif: bytes) -> bytes:
    """The EXIF block, focal length and all, of a photo whose pixels have been turned upright;
    empty if it is too long for a JPEG."""
    tags = tags_of(exif)
    tags[ORIENTATION] = 1
    try:
        block = tags.tobytes()
    except FAULTS:
        return b""
    return block if len(block) <= MOST_EXIF_BYTES else b""


def _profile(picture: Image.Image) -> bytes:
    profile = picture.info.get("icc_profile") or b""
    return profile if profile and _changes_colours(profile) else b""


@lru_cache(maxsize=64)  # photos of one camera have the same
def _changes_colours(profile: bytes) -> bool:
    """Whether colours of this profile differ from sRGB's, tried out because its name does not tell.
    False if broken; True if for grey or CMYK."""
    try:
        known = ImageCms.getOpenProfile(BytesIO(profile))
    except ImageCms.PyCMSError:
        return False
    with suppress(ImageCms.PyCMSError):
        shown = ImageCms.buildTransform(known, ImageCms.createProfile("sRGB"), "RGB", "RGB").apply(COLOURS)
        return max(ImageChops.difference(shown, COLOURS).tobytes()) > UNSEEN
    return True


def _jpeg_is_whole(data: mmap.mmap, picture: Image.Image) -> bool:
    """Whether an end marker follows the start of the first scan.
    Within scans FF comes before 00 or a restart marker, and thumbnails before scans."""
    position = 2
    while (marker := data[position : position + 2]) != SCAN and len(marker) == 2:
        stray = marker[0] != 0xFF or marker[1] in (0x00, 0xFF)
        position += 1 if stray else 2 + int.from_bytes(data[position + 2 : position + 4], "big")
    return data.rfind(END, position) >= 0


def _png_is_whole(data: mmap.mmap, picture: Image.Image) -> bool:
    return data.rfind(b"IEND") >= 0


def _webp_is_whole(data: mmap.mmap, picture: Image.Image) -> bool:
    return 8 + int.from_bytes(data[4:8], "little") <= len(data)


def _tiff_is_whole(data: mmap.mmap, picture: Image.Image) -> bool:
    """Whether it holds all strips or tiles of its picture."""
    assert isinstance(picture, TiffImageFile)
    places = zip((STRIPOFFSETS, TILEOFFSETS), (STRIPBYTECOUNTS, TILEBYTECOUNTS), strict=True)
    parts = [
        part
        for starts, lengths in places
        for part in zip(picture.tag_v2.get(starts, ()), picture.tag_v2.get(lengths, ()), strict=True)
    ]
    return bool(parts) and all(start + length <= len(data) for start, length in parts)


def _boxes_are_whole(data: mmap.mmap, picture: Image.Image) -> bool:
    """Whether it holds all of its boxes of metadata and pictures; phones append other things."""
    position = 0
    while head := data[position : position + 16]:
        size = int.from_bytes(head[8:] if head[:4] == LONG else head[:4], "big")
        if head[4:8] not in BOXES or size == 0:  # 0: up to the end
            return True
        position += max(size, 8)
    return position <= len(data)


IS_WHOLE = {
    **dict.fromkeys(("JPEG", "MPO"), _jpeg_is_whole),
    **dict.fromkeys(("HEIF", "AVIF"), _boxes_are_whole),
    "PNG": _png_is_whole,
    "WEBP": _webp_is_whole,
    "TIFF": _tiff_is_whole,
}
