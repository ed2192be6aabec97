"""Colours are those that the profile in a file says, in sRGB."""

import struct

import cv2
import numpy as np
import pytest
from PIL import Image, ImageCms

from core.data.photos.file import probe
from core.data.photos.pixels import read_pixels, read_pixels_and_alpha
from core.data.sfm.features import PHOTOS
from core.data.sfm.reconstruct import copy_upright
from core.report import QUIET

SRGB = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
# Where red is green and green is red.
SWAPPED = SRGB.replace(b"rXYZ", b"_").replace(b"gXYZ", b"rXYZ").replace(b"_", b"gXYZ")
GREY = SRGB.replace(b"RGB XYZ ", b"GRAYXYZ ").replace(b"rTRC", b"kTRC")
# The red, green and blue of Display P3, adapted to D50 as ICC profiles have them (columns of XYZ).
P3 = {b"rXYZ": (0.5151, 0.2412, -0.0011), b"gXYZ": (0.2920, 0.6922, 0.0419), b"bXYZ": (0.1571, 0.0666, 0.7841)}
COLOURS = cv2.resize(
    np.random.default_rng(0).integers(0, 256, (4, 5, 3), np.uint8), (50, 40), interpolation=cv2.INTER_LINEAR
)
WITHIN = 1  # 8-bit steps


def display_p3():
    profile = bytearray(SRGB)
    for tag, colour in P3.items():
        start = int.from_bytes(profile[(at := profile.index(tag) + 4) : at + 4], "big") + 8
        profile[start : start + 12] = struct.pack(">3i", *(round(value * 65536) for value in colour))
    return bytes(profile)


def save(path, pixels, profile, **options):
    if path.suffix == ".heic":
        import pillow_heif

        pillow_heif.from_pillow(Image.fromarray(pixels)).save(
            path, quality=-1, chroma=444, matrix_coefficients=0, icc_profile=profile
        )
    else:
        Image.fromarray(pixels).save(path, icc_profile=profile, **options)
    return path


def test_display_p3(tmp_path):
    """The red, green and blue of sRGB, white and grey, as phones write them."""
    colours = np.array([[[234, 51, 35], [117, 251, 76], [0, 0, 245], [255, 255, 255], [128, 128, 128]]], np.uint8)
    wanted = [[[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255], [128, 128, 128]]]
    # Dark channels round in large steps.
    assert np.abs(read_pixels(save(tmp_path / "a.png", colours, display_p3())).astype(int) - wanted).max() <= 5


@pytest.mark.parametrize(
    ("suffix", "options", "within"),
    [
        (".png", {}, WITHIN),
        (".tif", {}, WITHIN),
        (".webp", {"lossless": True}, WITHIN),
        (".jpg", {"quality": 100, "subsampling": 0}, 4),
        (".heic", {}, 4),
    ],
)
def test_colours_of_a_profile_become_those_of_srgb(tmp_path, suffix, options, within):
    path = save(tmp_path / f"a{suffix}", COLOURS, SWAPPED, **options)
    assert probe(path).profile == SWAPPED
    assert np.abs(read_pixels(path).astype(int) - COLOURS[..., [1, 0, 2]]).max() <= within


def test_alpha_stays_as_it_is(tmp_path):
    alpha = np.arange(50, dtype=np.uint8) * np.ones((40, 1), np.uint8) + 200
    pixels, found = read_pixels_and_alpha(save(tmp_path / "a.png", np.dstack([COLOURS, alpha]), SWAPPED))
    assert np.array_equal(found, alpha)
    over_white = COLOURS[..., [1, 0, 2]] * (alpha[..., None] / 255) + 255 - alpha[..., None]
    assert np.abs(pixels - over_white).max() <= 2 * WITHIN


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_grey_of_16_bits_has_the_shades_of_8(tmp_path, suffix):
    shades, curve = COLOURS[..., 0], int.from_bytes(GREY[(at := GREY.index(b"kTRC") + 4) : at + 4], "big")
    linear = GREY[:curve] + b"curv" + bytes(8) + GREY[curve + 12 :]
    path = save(tmp_path / f"a{suffix}", shades.astype(np.uint16) * 257, linear)
    assert probe(path).profile == linear and not np.array_equal(read_pixels(path)[..., 0], shades)
    assert np.array_equal(read_pixels(path), read_pixels(save(tmp_path / "b.png", shades, linear)))


def test_one_shade_is_transparent_in_a_grey_photo_with_a_profile(tmp_path):
    shades, path = COLOURS[..., 0], tmp_path / "a.png"
    Image.fromarray(shades).save(path, icc_profile=GREY, transparency=int(shades[0, 0]))
    pixels, alpha = read_pixels_and_alpha(path)
    assert probe(path).profile == GREY and np.array_equal(alpha == 0, shades == shades[0, 0])
    assert np.abs(pixels.astype(int) - np.where(alpha == 0, 255, shades)[..., None]).max() <= WITHIN


@pytest.mark.parametrize(
    "profile",
    [SRGB, b"broken", SWAPPED[:200], SWAPPED.replace(b"RGB XYZ ", b"CMYKLab ")],
    ids=["sRGB", "no profile", "cut short", "of inks"],
)
def test_srgb_and_profiles_of_no_use_change_nothing(tmp_path, profile):
    assert np.array_equal(read_pixels(save(tmp_path / "a.png", COLOURS, profile)), COLOURS)


def test_what_a_profile_is_called_does_not_count(tmp_path):
    called_srgb = "sRGB".encode("utf-16-be")
    assert called_srgb in SWAPPED and probe(save(tmp_path / "a.png", COLOURS, SWAPPED)).profile == SWAPPED
    assert (
        probe(save(tmp_path / "b.png", COLOURS, SRGB.replace(called_srgb, "c2  ".encode("utf-16-be")))).profile == b""
    )


def test_colmap_gets_srgb(tmp_path):
    plain = save(tmp_path / "plain.jpg", COLOURS[::-1], SRGB)
    other = save(tmp_path / "other.jpg", COLOURS, SWAPPED, quality=100, subsampling=0)
    copies, _ = copy_upright([other, plain], tmp_path, QUIET)
    copied = {name: tmp_path / PHOTOS / copy for copy, name in copies.items()}
    assert copied["plain.jpg"].read_bytes() == plain.read_bytes()
    assert probe(copied["other.jpg"]).profile == b""
    # With coarser colours.
    assert np.abs(read_pixels(copied["other.jpg"]).astype(int) - COLOURS[..., [1, 0, 2]]).mean() < 4
