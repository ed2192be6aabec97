"""Headers: size and rotation of photo files, and whether they are complete, found without decoding them."""

import struct
import zlib

import cv2
import numpy as np
import pytest
from PIL import Image, ImageFile
from PIL.TiffImagePlugin import PHOTOMETRIC_INTERPRETATION, PLANAR_CONFIGURATION, SAMPLESPERPIXEL

from core.data.photos.file import ORIENTATION, probe, tags_of, upright_exif
from core.data.photos.pixels import read_pixels
from core.errors import BadInput
from tests.data.small_scene import add_exif, exif_block


def write(path, height=24, width=40, *options):
    pixels = np.random.default_rng(0).integers(0, 256, (height, width, 3), np.uint8)
    assert cv2.imwrite(str(path), pixels, list(options))
    return path


# 101: lossless.
@pytest.mark.parametrize(("quality", "channels", "chunk"), [(80, 3, b"VP8 "), (101, 3, b"VP8L"), (80, 4, b"VP8X")])
@pytest.mark.parametrize("size", [(1, 2), (300, 5000), (16383, 3)])
def test_the_size_of_webp_is_read_without_decoding_it(tmp_path, monkeypatch, quality, channels, chunk, size):
    path, (width, height) = tmp_path / "photo.webp", size
    pixels = np.random.default_rng(0).integers(0, 256, (height, width, channels), np.uint8)
    assert cv2.imwrite(str(path), pixels, [cv2.IMWRITE_WEBP_QUALITY, quality]) and path.read_bytes()[12:16] == chunk
    monkeypatch.setattr(ImageFile.ImageFile, "load", None)
    assert probe(path).displayed == size


def write_tiff(path, pixels, orientation=1, **options):
    """A TIFF by Pillow, which begins with its directory where nothing is compressed."""
    Image.fromarray(pixels).save(path, tiffinfo={ORIENTATION: orientation}, **options)
    return path


COLOURS = np.random.default_rng(0).integers(0, 256, (24, 40, 3), np.uint8)


@pytest.mark.parametrize(
    ("pixels", "options"),
    [
        (COLOURS, {}),
        (COLOURS, {"compression": "tiff_lzw", "strip_size": 300}),
        (COLOURS, {"compression": "jpeg"}),
        (COLOURS[..., 0].astype(">u2"), {}),
    ],
    ids=["plain", "several strips", "jpeg", "big-endian"],
)
@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_size_of_tiff_is_read_without_decoding_it_and_is_the_decoders(
    tmp_path, monkeypatch, pixels, options, orientation
):
    path = write_tiff(tmp_path / "photo.tif", pixels, orientation, **options)
    shown = read_pixels(path)
    monkeypatch.setattr(ImageFile.ImageFile, "load", None)
    header = probe(path)
    assert header.displayed == shown.shape[1::-1] and (header.width, header.height, header.orientation) == (
        40,
        24,
        orientation,
    )


DEEP = COLOURS[..., 0].astype(np.uint16) * 257


@pytest.mark.parametrize(
    ("shades", "tags"),
    [(COLOURS[..., 0] / np.float32(255), {}), (DEEP.astype(np.int32), {}), (DEEP, {PHOTOMETRIC_INTERPRETATION: 0})],
    ids=["fractions", "32 bits", "0 is white"],
)
def test_tiff_that_pillow_reads_wrongly_is_refused(tmp_path, shades, tags):
    path = tmp_path / "photo.tif"
    Image.fromarray(shades).save(path, tiffinfo=tags)
    with pytest.raises(BadInput, match="photo.tif is not a photo that can be read"):
        probe(path)


def test_tiff_of_16_bits_with_channels_apart_is_refused(tmp_path):
    path = tmp_path / "photo.tif"
    assert cv2.imwrite(str(path), COLOURS.astype(np.uint16) * 257, [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    assert probe(path).displayed == (40, 24)
    tag = struct.pack("<HHI", PLANAR_CONFIGURATION, 3, 1)
    path.write_bytes(path.read_bytes().replace(tag + b"\1", tag + b"\2"))
    with pytest.raises(BadInput, match="photo.tif is not a photo that can be read"):
        probe(path)


@pytest.mark.parametrize("kind", ["EPS", "TGA", "ICO"])
def test_formats_that_no_photo_has_are_refused(tmp_path, kind):
    path = tmp_path / "photo.jpg"
    Image.fromarray(COLOURS).save(path, kind)
    with pytest.raises(BadInput, match="photo.jpg is not a photo that can be read"):
        probe(path)


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")  # as without pytest
@pytest.mark.parametrize(("side", "is_read"), [(1 << 15, True), (33_000, False)])
def test_a_picture_has_at_most_a_billion_pixels(tmp_path, side, is_read):
    path = write(tmp_path / "photo.png")
    data = path.read_bytes()
    head = b"IHDR" + struct.pack(">II", side, side) + data[24:29]
    path.write_bytes(data[:12] + head + struct.pack(">I", zlib.crc32(head)) + data[33:])
    if is_read:
        assert probe(path).displayed == (side, side)
        return
    with pytest.raises(BadInput, match="photo.png is not a photo that can be read"):
        probe(path)


def test_exif_may_come_behind_the_picture_of_a_png(tmp_path):
    path = write(tmp_path / "photo.png")
    add_exif(path, exif_block(6))
    data = path.read_bytes()
    start = data.index(b"eXIf") - 4
    end = start + 12 + int.from_bytes(data[start : start + 4], "big")
    path.write_bytes(data[:start] + data[end:-12] + data[start:end] + data[-12:])
    assert probe(path).orientation == 6 and probe(path).displayed == (24, 40) == read_pixels(path).shape[1::-1]


def test_pillow_logs_nothing_of_a_broken_photo(tmp_path, caplog):
    path = write_tiff(tmp_path / "photo.tif", COLOURS)
    tag = struct.pack("<HHI", SAMPLESPERPIXEL, 3, 1)
    path.write_bytes(path.read_bytes().replace(tag + b"\3", tag + b"\x99"))
    with pytest.raises(BadInput, match="photo.tif is not a photo that can be read"):
        probe(path)
    assert not caplog.records


@pytest.mark.parametrize(("suffix", "options"), [(".jpg", (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)), (".webp", ())])
def test_progressive_jpeg_and_trailing_bytes_are_whole(tmp_path, suffix, options):
    path = write(tmp_path / f"photo{suffix}", 24, 40, *options)
    path.write_bytes(path.read_bytes() + b"a film that the phone appended")
    assert probe(path).displayed == (40, 24)


@pytest.mark.parametrize("stray", [b"x", b"stray bytes", b"x\xff\xff", b"\xff\x00\x00\x10", b"\x00\xff"])
def test_stray_bytes_before_a_marker_are_skipped_as_decoders_do(tmp_path, stray):
    path = write(tmp_path / "photo.jpg")
    data = path.read_bytes()
    tables = data.index(b"\xff\xdb")
    path.write_bytes(data[:tables] + stray + data[tables:])
    assert probe(path).displayed == (40, 24) == cv2.imread(str(path)).shape[1::-1]


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_displayed_size_is_the_decoders(tmp_path, suffix, order, orientation):
    path = write(tmp_path / f"photo{suffix}")
    add_exif(path, exif_block(orientation, order))
    shown = cv2.imread(str(path))
    assert probe(path).orientation == orientation
    assert probe(path).displayed == (shown.shape[1], shown.shape[0])


def test_orientation_is_taken_out_and_the_rest_stays():
    tags = dict(tags_of(exif_block(6, ">")))
    assert dict(tags_of(upright_exif(exif_block(6, ">")))) == tags | {ORIENTATION: 1}


@pytest.mark.parametrize(
    "block", [b"", b"II", b"II*\0\xff\xff\xff\xff", b"nonsense", exif_block(6)[:16], exif_block(77)]
)
def test_broken_exif_means_not_turned(tmp_path, block):
    path = write(tmp_path / "photo.jpg")
    add_exif(path, block)
    assert probe(path).orientation == 1


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".tif"])
def test_every_cut_of_a_photo_is_noticed(tmp_path, suffix):
    path = tmp_path / f"photo{suffix}"
    data = (write_tiff(path, COLOURS[:4, :4]) if suffix == ".tif" else write(path, 4, 4)).read_bytes()
    for length in range(len(data) - 4 * (suffix == ".png")):  # nobody misses the last checksum of a PNG
        path.write_bytes(data[:length])
        with pytest.raises(BadInput, match=f"photo{suffix}"):
            probe(path)


PNG = b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize(
    "content",
    [
        b"text",
        b"\xff\xd8\xff\xe0",
        b"\xff\xd8abcd",
        PNG + b"\0" * 12,
        PNG + b"\0\0\0\0IHDR" + b"\0" * 4,
        b"RIFF\x04\0\0\0WEBP",
    ],
    ids=["text", "segment cut short", "no segment", "empty chunk", "size missing", "no chunks"],
)
def test_what_is_no_photo_is_refused(tmp_path, content):
    path = tmp_path / "photo.jpg"
    path.write_bytes(content)
    with pytest.raises(BadInput, match="photo.jpg"):
        probe(path)


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(BadInput, match="No such file"):
        probe(tmp_path / "none.jpg")
