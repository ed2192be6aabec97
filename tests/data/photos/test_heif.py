"""HEIC and AVIF photos: read as other photos are, turned as the file itself says."""

import cv2
import numpy as np
import pytest
from PIL import Image
from pillow_heif import from_bytes, from_pillow

from core.data.photos.file import probe
from core.data.photos.pixels import read_light, read_pixels, upright
from core.data.sfm.reconstruct import write_jpeg
from core.data.sfm.usable import UsablePhoto
from core.errors import BadInput
from tests.data.small_scene import exif_block

WITHIN = 6  # 8-bit steps, of lossy coding
TURNED = "the file's own rotation, as phones write it", "EXIF's alone, which does not count"


def ramps(height=64, width=96):
    y, x = np.mgrid[:height, :width]
    return np.stack([255 * x / width, 255 * y / height, 0 * x + 90], axis=2).astype(np.uint8)


def write(path, pixels, mode="RGB"):
    height, width = pixels.shape[:2]
    from_bytes(mode, (width, height), np.ascontiguousarray(pixels).tobytes()).save(path, quality=98)
    return path


def difference(found, pixels):
    assert found.shape == pixels.shape
    return np.abs(found.astype(int) - pixels).max()


@pytest.mark.parametrize("how", TURNED)
@pytest.mark.parametrize("orientation", range(1, 9))
def test_photos_are_turned_as_the_file_says(tmp_path, orientation, how):
    path, pixels = tmp_path / "IMG_1.HEIC", ramps()
    written = orientation if how == TURNED[0] else 1  # the writer makes a rotation of EXIF's
    from_pillow(Image.fromarray(pixels)).save(path, quality=98, exif=b"Exif\0\0" + exif_block(written))
    path.write_bytes(path.read_bytes().replace(exif_block(written), exif_block(orientation)))
    pixels = upright(pixels, written)
    header = probe(path)
    assert (header.kind, header.orientation, header.displayed) == ("HEIF", 1, pixels.shape[1::-1])
    assert difference(read_pixels(path), pixels) <= WITHIN
    jpeg = tmp_path / "copy.jpg"
    write_jpeg(UsablePhoto(header, read_pixels(path)), jpeg)  # as structure from motion gets it
    assert probe(jpeg).displayed == header.displayed and exif_block(1) in probe(jpeg).exif
    assert difference(cv2.imread(str(jpeg))[..., ::-1], pixels) <= 2 * WITHIN


@pytest.mark.parametrize("mode", ["RGB", "RGB;16", "L", "L;16"])
def test_deep_and_grey_photos_of_odd_sizes(tmp_path, mode):
    pixels = ramps(75, 131)
    grey, deep = mode.startswith("L"), mode.endswith("16")
    stored = pixels[..., 0] if grey else pixels
    path = write(tmp_path / "a.heic", stored.astype(np.uint16) * 257 if deep else stored, mode)
    assert difference(read_pixels(path), np.repeat(pixels[..., :1], 3, axis=2) if grey else pixels) <= WITHIN


def test_what_is_transparent_gives_no_light(tmp_path):
    pixels = ramps()
    alpha = np.where(np.arange(96) < 48, 255, 0) * np.ones((64, 1))
    path = write(tmp_path / "a.heif", np.dstack([pixels, alpha.astype(np.uint8)]), "RGBA")
    assert difference(read_pixels(path)[:, :44], pixels[:, :44]) <= WITHIN and (read_pixels(path)[:, 52:] > 250).all()
    assert read_light(path)[:, 60:, 0].max() < 140  # of the left half


def test_every_cut_is_noticed(tmp_path):
    path = write(tmp_path / "IMG_2.heic", ramps())
    data = path.read_bytes()
    path.write_bytes(data + b"\0\0\1\0mpvd")  # what a phone appended
    assert probe(path).displayed == (96, 64)
    between_boxes = data.index(b"mdat") - 4
    for length in range(len(data)):
        path.write_bytes(data[:length])
        with pytest.raises(BadInput, match="IMG_2.heic (ends before|is empty|is not a photo)"):
            read_pixels(path)  # which decodes
        if not between_boxes <= length < between_boxes + 8:
            with pytest.raises(BadInput, match="IMG_2.heic (ends before|is empty|is not a photo)"):
                probe(path)


def test_corrupted_bytes_cause_no_traceback(tmp_path):
    data = write(tmp_path / "a.heic", ramps()).read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(100):
        broken = bytearray(data)
        for place in rng.integers(0, len(data), 5):
            broken[place] = rng.integers(0, 256)
        (tmp_path / "b.heic").write_bytes(broken)
        try:
            assert read_pixels(tmp_path / "b.heic").ndim == 3
        except BadInput:
            pass


@pytest.mark.parametrize("orientation", range(1, 9))
def test_avif_photos_are_turned_and_a_cut_is_noticed(tmp_path, orientation):
    path, pixels = tmp_path / "a.avif", ramps()
    Image.fromarray(pixels).save(path, quality=95, exif=exif_block(orientation))
    assert difference(read_pixels(path), upright(pixels, orientation)) <= WITHIN
    assert probe(path).displayed == read_pixels(path).shape[1::-1]
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(BadInput, match="a.avif ends before"):
        probe(path)
