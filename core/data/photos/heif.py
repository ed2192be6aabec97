"""Photos as phones save them (HEIC and other HEIF), which OpenCV cannot read."""

import mmap

import numpy as np

BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")
BOXES = (b"ftyp", b"meta", b"mdat", b"free", b"skip", b"moov")
LONG = b"\0\0\0\1"  # in place of a box's size, which then follows
FAULTS = (ValueError, LookupError, EOFError, SyntaxError, RuntimeError)  # of a file that is damaged or coded in another way


def is_heif(data: bytes | mmap.mmap) -> bool:
    """Whether a file begins as HEIF does."""
    return data[4:8] == b"ftyp" and data[8:12] in BRANDS


def is_whole(data: bytes) -> bool:
    """Whether the file holds all of its boxes of metadata and pictures; phones append other things."""
    position = 0
    while head := data[position : position + 16]:
        size = int.from_bytes(head[8:] if head[:4] == LONG else head[:4], "big")
        if head[4:8] not in BOXES or size == 0:  # 0: up to the end
            return True
        position += max(size, 8)
    return position <= len(data)


def size_and_exif(data: bytes) -> tuple[tuple[int, int], bytes]:
    """Width and height as displayed, and the EXIF block, if any, as in a JPEG; nothing is decoded. Raises one of FAULTS.

    The rotation is the file's own, which decoding applies; EXIF's is not to be applied once more.
    """
    picture = _open(data)
    return picture.size, picture.info.get("exif") or b""


def decode_heif(data: bytes) -> np.ndarray:
    """As OpenCV would decode it: as displayed, (H, W), (H, W, 3) BGR or (H, W, 4) BGRA, of 8 bits, or 16 if grey. Raises one of FAULTS."""
    picture = _open(data)  # whose memory goes with it
    return np.array(picture)[:, : picture.size[0]]  # rows may be padded


def _open(data: bytes):
    from pi_heif import open_heif  # late: few collections have such photos

    return open_heif(data, bgr_mode=True)
