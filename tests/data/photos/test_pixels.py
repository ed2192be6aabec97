"""Pixels: every kind of photo file, as displayed, at the size wanted."""

import base64
import struct
import zlib
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from core.data.collection import GivenMask, Photo
from core.data.photos import distortion
from core.data.photos.file import probe
from core.data.photos.pixels import (
    OPAQUE,
    load_photo,
    read_light,
    read_mask,
    read_pixels,
    read_pixels_and_alpha,
    upright,
)
from core.data.photos.stored import reduction
from core.errors import BadInput
from core.scene.camera import Camera
from core.scene.lens import Lens
from tests.data.small_scene import add_exif, centroid, draw_dots, exif_block

# A 16x16 CMYK JPEG of the colour (200, 40, 60), as OpenCV cannot write one.
CMYK_JPEG = zlib.decompress(
    base64.b64decode(
        "eNr7f+P/OwY+x5T8pFSGFAYQ+H+bwZmBg42NnY2Vg52dnZOTg4tHhJeHm5tHUkiYX0RWSl5OVkpGRkFFT11BSUdZRkbDXFPHwNDE"
        "xERe3dLWwshGz9jE6P8BBhEOBgEGARZnQQZfQYZIQQZvQYb/RxjkGRgYWRnBgAEKGJmYWVjZ2Dk4ubiBCrYKMDAxMjMzsTCzsrKw"
        "AGVrgfIMLIKsQoqGjmzCgYnsSoUiRo0TF3IoO208KBp08YOKcVJREyeXmLiEpJSqmrqGppaJqZm5haWVs4urm7uHp1dwSGhYeERk"
        "VHJKalp6RmZWcUlpWXlFZVVzS2tbe0dn16TJU6ZOmz5j5qxFi5csXbZ8xcpVmzZv2bpt+46duw4dPnL02PETJ09dunzl6rXrN27e"
        "evjo8ZOnz56/ePnq46fPX75++/7j56//txj4WJwZfBkiGbwZGOwZvnR9qvq86/svjUVdEPT/JgB1THdc"
    )
)


def noise(height=30, width=44, channels=3, kind=np.uint8):
    shape = (height, width, channels) if channels > 1 else (height, width)
    return np.random.default_rng(0).integers(0, np.iinfo(kind).max + 1, shape, kind)


def save(path, pixels):
    assert cv2.imwrite(str(path), pixels)
    return path


def photo_at(path, width, height, lens=None):
    camera = Camera.centred(np.eye(3), np.zeros(3), 50.0, width, height)
    return Photo(path.name, path, camera, "train", np.empty(0, np.int64), lens)


def test_colour_is_rgb(tmp_path):
    pixels = noise()
    assert (read_pixels(save(tmp_path / "a.png", pixels)) == pixels[..., ::-1]).all()


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_rotation_is_applied_as_opencv_does(tmp_path, suffix, orientation):
    path = save(tmp_path / f"a{suffix}", noise())
    add_exif(path, exif_block(orientation))
    assert (read_pixels(path) == cv2.imread(str(path))[..., ::-1]).all()


@pytest.mark.parametrize("suffix", [".png", ".webp"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_alpha_is_turned_along(tmp_path, suffix, orientation):
    pixels = noise(channels=4)
    pixels[..., 3] = np.where(noise(channels=1) > 127, 255, 0)
    path = save(tmp_path / f"a{suffix}", pixels)
    add_exif(path, exif_block(orientation))
    shown = upright(pixels, orientation)
    loaded = load_photo(photo_at(path, shown.shape[1], shown.shape[0]), shown.shape[1], shown.shape[0])
    assert (loaded.valid == (shown[..., 3] == 255)).all()
    assert (loaded.pixels[loaded.valid] == shown[loaded.valid][:, 2::-1]).all()


def test_what_is_transparent_is_shown_over_white(tmp_path):
    pixels = np.full((4, 4, 4), 100, np.uint8)
    pixels[..., 3] = 51
    assert (read_pixels(save(tmp_path / "a.png", pixels)) == 224).all()  # 100 * 0.2 + 255 * 0.8


@pytest.mark.parametrize(("kind", "multiplied"), [(1, True), (2, False)], ids=["multiplied by alpha", "straight"])
def test_what_is_half_transparent_in_a_tiff_is_shown_as_in_a_png(tmp_path, kind, multiplied):
    straight = noise(channels=4)
    straight[0, 0, 3] = 0
    stored = straight.copy()
    if multiplied:
        stored[..., :3] = np.rint(straight[..., :3] * (straight[..., 3:] / 255))
    path = tmp_path / "a.tif"
    Image.fromarray(stored).save(path)  # which calls it straight
    extra_samples = struct.pack("<HHI", 338, 3, 1)
    path.write_bytes(path.read_bytes().replace(extra_samples + bytes([2]), extra_samples + bytes([kind])))
    found, alpha = read_pixels_and_alpha(path)
    expected, same_alpha = read_pixels_and_alpha(save(tmp_path / "a.png", straight[..., [2, 1, 0, 3]]))
    assert np.array_equal(alpha, same_alpha)
    assert np.abs(found.astype(int) - expected).max() <= 2  # rounded three times


def test_what_is_transparent_gives_no_light(tmp_path):
    pixels = np.full((8, 6, 4), 40, np.uint8)
    pixels[..., 3], pixels[4:] = 255, (255, 255, 255, 0)
    path = save(tmp_path / "a.png", pixels)
    add_exif(path, exif_block(6))
    assert read_light(path).shape == (6, 8, 3) and (read_light(path) == 40).all() and read_pixels(path).max() == 255
    pixels[..., 3] = 0
    with pytest.raises(BadInput, match="a.png shows something in 0.0% of its pixels: the others are transparent"):
        read_light(save(tmp_path / "a.png", pixels))


def test_a_photo_that_shows_nothing_is_named(tmp_path):
    path = save(tmp_path / "a.png", np.zeros((30, 44, 4), np.uint8))
    with pytest.raises(BadInput, match="a.png shows nothing"):
        load_photo(photo_at(path, 44, 30), 44, 30)


@pytest.mark.parametrize("alpha", [255, 254, OPAQUE])
def test_opaque_alpha_leaves_all_pixels_valid(tmp_path, alpha):
    pixels = noise(channels=4)
    pixels[..., 3] = alpha
    path = save(tmp_path / "a.png", pixels)
    assert load_photo(photo_at(path, 44, 30), 44, 30).valid is None
    assert np.array_equal(read_light(path), pixels[..., 2::-1])


@pytest.mark.parametrize("orientation", [1, 6])
def test_where_transparent_is_empty_the_photo_is_over_white_and_says_how_empty_it_is(tmp_path, orientation):
    pixels = noise(channels=4)
    pixels[..., 3] //= 2  # nothing is opaque, and all of it counts
    path = save(tmp_path / "a.png", pixels)
    add_exif(path, exif_block(orientation))
    shown = upright(pixels, orientation).astype(np.float64)
    height, width = shown.shape[0] // 2, shown.shape[1] // 2
    loaded = load_photo(photo_at(path, 2 * width, 2 * height), width, height, transparent_is_empty=True)
    assert loaded.valid is None
    for colour in (0, 100, 255):
        over = shown[..., 2::-1] * shown[..., 3:] / 255 + colour * (1 - shown[..., 3:] / 255)
        over = over.reshape(height, 2, width, 2, 3).mean(axis=(1, 3))
        found = loaded.pixels - loaded.empty[..., None] * (1 - colour / 255)
        assert np.abs(found - over).max() <= 1.5  # rounded before and after it is shrunk, as is what is empty after


def test_opaque_photos_have_nothing_empty(tmp_path):
    pixels = noise(channels=4)
    pixels[..., 3] = 255
    for path in (save(tmp_path / "a.png", pixels), save(tmp_path / "b.png", pixels[..., :3])):
        loaded = load_photo(photo_at(path, 44, 30), 44, 30, transparent_is_empty=True)
        assert loaded.empty is None and loaded.pixels.shape == (30, 44, 3)


# The second is shrunk before it is undistorted, by no whole factor.
@pytest.mark.parametrize("size", [(44, 30), (31, 21)])
def test_what_is_empty_goes_through_lens_and_mask_as_colours_do(tmp_path, size):
    pixels = cv2.GaussianBlur(noise(60, 88, 4), (0, 0), 3)
    grey = np.dstack([255 - pixels[..., 3]] * 3)
    mask = np.full((60, 88), 255, np.uint8)
    mask[:, :20] = 0
    lens = Lens("SIMPLE_RADIAL", 88, 60, [50.0, 44.0, 30.0, 0.2])
    loaded = []
    for name, kept in (("a.png", pixels), ("b.png", grey)):
        photo = replace(
            photo_at(save(tmp_path / name, kept), 88, 60, lens), mask=GivenMask(save(tmp_path / "mask.png", mask))
        )
        loaded.append(load_photo(photo, *size, transparent_is_empty=True))
    transparent, opaque = loaded
    assert 0.3 < opaque.valid.mean() < 0.9 and np.array_equal(transparent.valid, opaque.valid)
    assert np.array_equal(transparent.empty[opaque.valid], opaque.pixels[opaque.valid][:, 0])


@pytest.mark.parametrize("white", [(255, 255, 255, 255), (255, 255, 255, 140)])
@pytest.mark.parametrize("hidden", [(0, 0, 0, 255), (255, 255, 255, 0), (0, 0, 0, 0), (255, 255, 255, 100)])
def test_what_is_transparent_in_a_mask_is_hidden(tmp_path, white, hidden):
    mask = np.empty((30, 44, 4), np.uint8)
    mask[:10], mask[10:] = hidden, white
    path = save(tmp_path / "mask.png", mask)
    photo = replace(photo_at(save(tmp_path / "a.png", noise()), 44, 30), mask=GivenMask(path))
    assert (load_photo(photo, 44, 30).valid == (np.arange(30) >= 10)[:, None]).all()


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("white", [1, 255, 65535])
def test_white_of_a_mask_of_16_bits_is_255_or_1_as_well(tmp_path, suffix, white):
    path, shades = save(tmp_path / "a.png", noise()), np.full((30, 44), white, np.uint16)
    shades[:10] = 0
    mask = save(tmp_path / f"m{suffix}", shades)
    assert np.array_equal(
        load_photo(replace(photo_at(path, 44, 30), mask=GivenMask(mask)), 44, 30).valid, shades == white
    )


def test_the_mean_of_the_colours_decides_what_is_white(tmp_path):
    colours = np.full((30, 44, 3), 255, np.uint8)
    colours[:8], colours[8:12], colours[12:16] = 0, (0, 128, 255), (127, 1, 255)  # the last two: 127.67
    mask = save(tmp_path / "m.png", colours)
    wanted = np.full((30, 44), True)
    wanted[:16] = False
    assert np.array_equal(read_mask(mask, (44, 30)), wanted)


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
def test_grey_becomes_three_equal_channels(tmp_path, suffix):
    pixels = read_pixels(save(tmp_path / f"a{suffix}", np.full((5, 7), 90, np.uint8)))
    assert pixels.shape == (5, 7, 3) and (pixels == 90).all()


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_16_bits_become_8(tmp_path, suffix, channels):
    pixels = noise(channels=channels, kind=np.uint16)
    if channels == 4:
        pixels[..., 3] = 0xFFFF
    exact = np.atleast_3d(pixels) / 257
    wanted = exact[..., 2::-1] if channels > 1 else np.repeat(exact, 3, axis=2)
    # Decoders round to nearest or keep the upper 8 bits; both are within one step.
    assert np.abs(read_pixels(save(tmp_path / f"a{suffix}", pixels)) - wanted).max() <= 1


def test_cmyk_is_converted(tmp_path):
    path = tmp_path / "a.jpg"
    path.write_bytes(CMYK_JPEG)
    assert np.abs(read_pixels(path).astype(int) - (200, 40, 60)).max() <= 3  # JPEG's own rounding


@pytest.mark.parametrize("value", [0, 128, 255])
def test_constant_photos_are_photos(tmp_path, value):
    assert (read_pixels(save(tmp_path / "a.jpg", np.full((9, 9, 3), value, np.uint8))) == value).all()


def test_a_photo_of_one_pixel_is_read(tmp_path):
    path = save(tmp_path / "a.png", np.full((1, 1, 3), 7, np.uint8))
    assert read_pixels(path).shape == (1, 1, 3)
    assert (load_photo(photo_at(path, 1, 1), 3, 2).pixels == 7).all()


def test_a_jpeg_cut_short_before_an_end_marker_is_refused(tmp_path):
    path = save(tmp_path / "a.jpg", noise(200, 200))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2] + b"\xff\xd9")
    with pytest.raises(BadInput, match="a.jpg .*truncated.*or has a grey border below"):
        read_pixels(path)


def test_a_damaged_png_is_refused(tmp_path, capfd):
    path = save(tmp_path / "a.png", noise())
    data = bytearray(path.read_bytes())
    data[60:200] = bytes(140)
    path.write_bytes(data)
    with pytest.raises(BadInput, match="a.png"):
        read_pixels(path)
    capfd.readouterr()  # libpng's own complaint


@pytest.mark.parametrize(
    ("size", "divisor", "factor"), [((333, 251), 9, 1), ((1000, 752), 9, 8), ((997, 751), 9, 1), ((999, 751), 12, 8)]
)
@pytest.mark.parametrize("orientation", [1, 6])
def test_shrunk_jpegs_stay_aligned(tmp_path, size, divisor, factor, orientation):
    """A dot stays where the resized camera says, although JPEGs are decoded at a fraction of their size."""
    width, height = size
    dots = np.array([[0.1, 0.15], [0.9, 0.85], [0.5, 0.5]]) * (width, height)
    path = save(tmp_path / "a.jpg", draw_dots(dots, width, height, sigma=0.02 * width))
    add_exif(path, exif_block(orientation))
    if orientation == 6:
        dots = np.column_stack([height - dots[:, 1], dots[:, 0]])
        width, height = height, width
    small = (width // divisor, height // divisor)
    assert reduction(probe(path), small) == factor
    loaded = load_photo(photo_at(path, width, height), *small)
    for dot in dots * small / (width, height):
        # 0.1 px from a reduction that does not divide the size (MISALIGNED_PX) and 0.05 for rounding to 8 bits.
        assert np.abs(centroid(loaded.pixels, dot, 0.2 * small[0] / 2) - dot).max() < 0.15


def test_shrinking_averages(tmp_path):
    pixels = np.zeros((64, 64, 3), np.uint8)
    pixels[::2] = 255
    loaded = load_photo(photo_at(save(tmp_path / "a.png", pixels), 64, 64), 16, 16)
    assert loaded.pixels.shape == (16, 16, 3) and np.abs(loaded.pixels.astype(int) - 128).max() <= 1


def test_a_shrunk_pixel_is_valid_where_all_it_averages_is(tmp_path):
    pixels = noise(8, 8, 4)
    pixels[..., 3] = 255
    pixels[0, 5, 3] = OPAQUE - 1
    loaded = load_photo(photo_at(save(tmp_path / "a.png", pixels), 8, 8), 2, 2)
    assert loaded.valid.tolist() == [[True, False], [True, True]]


def test_a_turned_photo_is_undistorted_at_the_size_it_has_when_turned(tmp_path, monkeypatch):
    path = save(tmp_path / "a.png", noise(100, 400))
    add_exif(path, exif_block(6))
    lens = Lens("SIMPLE_RADIAL", 400, 100, [300.0, 200.0, 50.0, 0.01], orientation=6)
    sizes, undistort = [], distortion.undistort

    def watched(pixels, lens, camera):
        sizes.append((pixels.shape[:2], (camera.width, camera.height)))
        return undistort(pixels, lens, camera)

    monkeypatch.setattr(distortion, "undistort", watched)
    assert load_photo(photo_at(path, 100, 400, lens), 10, 40).pixels.shape == (40, 10, 3)
    assert sizes == [((20, 80), (20, 80))]  # twice as many pixels as are wanted: stored lying, seen standing
