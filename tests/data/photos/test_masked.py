"""A mask that the user gives lies on its photo as the photo is displayed, and hides every pixel that any of it covers."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from core.data import load_collection
from core.data.collection import GivenMask
from core.data.given_masks import check_fits, size_for_mask, with_mask
from core.data.photos import distortion
from core.data.photos.pixels import load_photo, read_light, read_pixels
from core.errors import BadInput
from core.scene.lens import Lens
from tests.data.photos.test_pixels import noise, photo_at, save
from tests.data.small_scene import HEIGHT, WIDTH, SmallScene, add_exif, exif_block


def save_mask(path, height=36, width=48, hidden=np.s_[20:, :10]):
    mask = np.full((height, width), 255, np.uint8)
    mask[hidden] = 0
    path.parent.mkdir(parents=True, exist_ok=True)
    return save(path, mask)


def test_a_mask_as_it_was_taken_fits_however_wide_the_lens(tmp_path):
    """COLMAP's copy of such a photo is of another shape than the photo."""
    lens = Lens("SIMPLE_RADIAL", 160, 106, [112.0, 80.0, 53.0, -0.25])
    photo = photo_at(save(tmp_path / "copy.png", np.zeros((114, 199, 3), np.uint8)), 199, 114)
    photo = replace(photo, camera=replace(photo.camera, fx=112.0, fy=112.0))
    found = with_mask(photo, save_mask(tmp_path / "mask.png", 106, 160, np.s_[:50]), (160, 106), lens)
    check_fits(found.mask.path, (160, 106), size_for_mask(found))
    assert 0.2 < load_photo(found, 199, 114).valid.mean() < 0.8


def test_beyond_the_edges_of_a_mask_all_is_used(tmp_path):
    lens = Lens("SIMPLE_RADIAL", 160, 106, [112.0, 80.0, 53.0, -0.25])
    photo = photo_at(save(tmp_path / "copy.png", np.zeros((114, 199, 3), np.uint8)), 199, 114)
    photo = replace(photo, camera=replace(photo.camera, fx=80.0, fy=80.0))
    mask = save_mask(tmp_path / "mask.png", 106, 160, np.s_[:50])  # black up to its edges
    _, seen = distortion.undistort(np.zeros((106, 160, 1), np.uint8), lens, photo.camera)
    valid = load_photo(with_mask(photo, mask, (160, 106), lens), 199, 114).valid
    assert (~seen[:50]).sum() > 100 and valid[~seen].all() and not valid[:50][seen[:50]].any()


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_mask_lies_on_the_photo_as_displayed(tmp_path, orientation):
    path = save(tmp_path / "a.png", noise())
    add_exif(path, exif_block(orientation))
    whole = read_pixels(path)
    height, width = whole.shape[:2]
    mask = save_mask(tmp_path / "m.png", height, width, np.s_[: height // 3, : width // 2])
    loaded = load_photo(replace(photo_at(path, width, height), mask=GivenMask(mask)), width, height)
    use = cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE) == 255
    np.testing.assert_array_equal(loaded.valid, use)
    np.testing.assert_array_equal(loaded.pixels[use], whole[use])
    np.testing.assert_array_equal(read_light(path, mask), loaded.pixels)  # filled alike
    assert (loaded.pixels[~use] != whole[~use]).any(axis=1).mean() > 0.9  # noise: a chance hit is rare


def test_what_is_transparent_and_what_a_mask_hides_are_both_invalid(tmp_path):
    pixels = noise(36, 48, 4)
    pixels[..., 3] = 255
    pixels[:12, :30, 3] = 0
    path, mask = save(tmp_path / "a.png", pixels), save_mask(tmp_path / "m.png", hidden=np.s_[6:20, 20:40])
    expected = np.ones((36, 48), bool)
    expected[:12, :30] = expected[6:20, 20:40] = False
    np.testing.assert_array_equal(
        load_photo(replace(photo_at(path, 48, 36), mask=GivenMask(mask)), 48, 36).valid, expected
    )


def test_masks_of_other_sizes_and_shrunk_photos(tmp_path):
    path = save(tmp_path / "a.jpg", noise(64, 96))
    half = save_mask(tmp_path / "m.png", 32, 48, np.s_[8:16, 16:32])
    photo = replace(photo_at(path, 96, 64), mask=GivenMask(half))
    expected = np.ones((64, 96), bool)
    expected[16:32, 32:64] = False
    np.testing.assert_array_equal(load_photo(photo, 96, 64).valid, expected)
    # Shrunk, a pixel is hidden if any of it is: rows 16 to 31 of 64 are 4 to 7 of 16.
    np.testing.assert_array_equal(load_photo(photo, 24, 16).valid, expected[::4, ::4])


def test_a_mask_is_undistorted_with_its_photo(tmp_path):
    collection = load_collection(SmallScene(model="SIMPLE_RADIAL").write(tmp_path / "scene"))
    photo = collection.photos[1]
    stored = cv2.imread(str(photo.path))
    marked = save_mask(tmp_path / "m.png", HEIGHT, WIDTH, np.s_[30:60, 20:50])
    hidden = cv2.imread(str(marked), cv2.IMREAD_GRAYSCALE) == 0
    stored[hidden], stored[~hidden] = 0, 255
    painted = save(tmp_path / "painted.png", stored)  # the photo itself shows its mask
    loaded = load_photo(replace(photo, path=painted), WIDTH, HEIGHT)
    masked = load_photo(replace(photo, path=painted, mask=GivenMask(marked)), WIDTH, HEIGHT)
    assert not (loaded.pixels[masked.valid] < 250).any()  # nothing dark is left to be used
    rim = loaded.valid is not None and ~loaded.valid
    dark = (loaded.pixels < 128).all(axis=2) | rim
    # But for the pixels that mix both: an edge of 1 px around 30 x 30 px, within the 2 px of the kernel.
    assert (~masked.valid).sum() - dark.sum() < 4 * 30 * 2


def test_a_mask_that_leaves_nothing_is_a_mistake(tmp_path):
    path = save(tmp_path / "a.png", noise())
    mask = save(tmp_path / "m.png", np.zeros((30, 44), np.uint8))
    with pytest.raises(BadInput, match=r"a.png is left with 0.0% .* White \(255\)"):
        load_photo(replace(photo_at(path, 44, 30), mask=GivenMask(mask)), 44, 30)
    with pytest.raises(BadInput, match="White"):
        read_light(path, mask)


def test_zeros_and_ones_are_black_and_white(tmp_path):
    path, ones = save(tmp_path / "a.png", noise()), np.ones((30, 44), np.uint8)
    ones[:10] = 0
    mask = save(tmp_path / "m.png", ones)
    assert np.array_equal(load_photo(replace(photo_at(path, 44, 30), mask=GivenMask(mask)), 44, 30).valid, ones == 1)


def test_of_a_cut_out_the_transparency_is_the_mask(tmp_path):
    path, alpha = save(tmp_path / "a.png", noise()), np.full((30, 44, 1), 255, np.uint8)
    alpha[:10] = 0
    mask = save(tmp_path / "m.png", np.dstack([noise(), alpha]))
    assert np.array_equal(
        load_photo(replace(photo_at(path, 44, 30), mask=GivenMask(mask)), 44, 30).valid, alpha[..., 0] == 255
    )


def test_what_is_neither_black_nor_white_is_no_mask(tmp_path):
    path, photo = save(tmp_path / "a.png", noise()), save(tmp_path / "m.png", noise())
    red = save(tmp_path / "r.png", np.full((30, 44, 3), (0, 0, 255), np.uint8))
    for mask in (photo, red):
        with pytest.raises(
            BadInput, match=rf"The mask .*{mask.name} is none: \d+% .* neither black nor white. White \(255\)"
        ):
            load_photo(replace(photo_at(path, 44, 30), mask=GivenMask(mask)), 44, 30)


@pytest.mark.parametrize(("rows", "is_mistake"), [(1, True), (3, False)])
def test_a_mask_that_leaves_less_than_a_hundredth_is_a_mistake(tmp_path, rows, is_mistake):
    path, mask = save(tmp_path / "a.png", noise(200, 20)), save_mask(tmp_path / "m.png", 200, 20, np.s_[rows:])
    photo = replace(photo_at(path, 20, 200), mask=GivenMask(mask))
    if is_mistake:
        with pytest.raises(BadInput, match=r"a.png is left with 0.5% of its pixels by its mask\. White"):
            load_photo(photo, 20, 200)
    else:
        assert load_photo(photo, 20, 200).valid.sum() == rows * 20


def test_the_mask_of_a_photo_as_it_was_taken_lies_on_its_undistorted_copy(tmp_path):
    """A black disc near the corner, which the lens bent towards the middle, is hidden all of it, and little else."""
    width, height = 160, 120
    lens = Lens("SIMPLE_RADIAL", width, height, [130.0, 80.0, 60.0, -0.25])
    taken = np.full((height, width, 3), 255, np.uint8)
    cv2.circle(taken, (22, 20), 9, (0, 0, 0), -1)
    photo = photo_at(tmp_path / "copy.png", width + 8, height + 6)
    photo = replace(photo, camera=replace(photo.camera, fx=130.0, fy=130.0, cx=84.0, cy=63.0))
    copy, _ = distortion.undistort(taken, lens, photo.camera)
    save(photo.path, copy)
    mask = save(tmp_path / "mask.png", taken[..., 0])
    disc = copy[..., 0] < 128
    hidden = ~load_photo(with_mask(photo, mask, (width, height), lens), width + 8, height + 6).valid
    assert (hidden == disc).all() and disc.sum() > 200
    stretched = ~load_photo(with_mask(photo, mask, (width, height), None), width + 8, height + 6).valid
    assert (disc & ~stretched).sum() > 20
    # Drawn on the copy, whose size tells.
    own = with_mask(photo, save(tmp_path / "own.png", copy[..., 0]), (width + 8, height + 6), lens)
    assert own.mask.lens is None and (~load_photo(own, width + 8, height + 6).valid == disc).all()
