"""Masks that the user gives: found by name, said, and laid over the photo as the photo is laid out."""

import os
from dataclasses import replace

import cv2
import numpy as np
import pytest

from core.data import load_collection
from core.data.collection import GivenMask
from core.data.given_masks import check_fits, check_masks, size_for_mask, with_mask, with_masks_by_name, with_masks_in, with_same_masks
from core.data.photos import distortion
from core.data.photos.pixels import load_photo, read_light, read_pixels
from core.errors import BadInput
from core.scene.lens import Lens
from core.training.on_disk import run_config, run_folders
from tests.data.checks import notes_with, texts_of
from tests.data.photos.test_pixels import noise, photo_at, save
from tests.data.small_scene import HEIGHT, WIDTH, SmallScene, add_exif, exif_block
from tests.failing import DENIED, failing
from tests.small import small_collection, small_settings


@pytest.fixture
def collection(tmp_path):
    """photo_0 to photo_5; 2 and 5 are held out."""
    (tmp_path / "masks").mkdir()
    return small_collection(tmp_path)


def save_mask(path, height=36, width=48, hidden=np.s_[20:, :10]):
    mask = np.full((height, width), 255, np.uint8)
    mask[hidden] = 0
    path.parent.mkdir(parents=True, exist_ok=True)
    return save(path, mask)


def masks_of(photos):
    return [photo.mask and photo.mask.path for photo in photos]


def test_masks_are_found_by_stem_in_any_format_and_what_is_missing_is_said(collection, tmp_path):
    folder = tmp_path / "masks"
    save_mask(folder / "photo_0.jpg")
    save_mask(folder / "photo_1.bmp", 18, 24)
    save_mask(folder / "photo_2.png")  # of a held-out photo
    save_mask(folder / "passer.png")
    (folder / "read.me").write_text("not a picture")
    found = with_masks_in(collection, folder)
    assert [photo.mask and photo.mask.path.name for photo in found.photos] == ["photo_0.jpg", "photo_1.bmp", "photo_2.png", None, None, None]
    assert all(photo.mask is None for photo in found.split("test"))
    assert texts_of(found.notes) == [
        f"2 photos with a mask from {folder}.",
        "1 photo with a mask of another size, which is resized: photo_1.png",
        "2 photos without a mask, used whole: photo_3.png, photo_4.png",
        "1 mask of no photo in use, such as passer.png.",
    ]
    again = with_same_masks(collection, found)
    assert [tuple(vars(photo).values()) for photo in again.photos] == [tuple(vars(photo).values()) for photo in found.photos]


def test_masks_of_photos_whose_cameras_were_found_are_known_by_the_name_the_user_gave(collection, tmp_path):
    """Structure from motion makes a photo.png.jpg of a photo.png."""
    photos = tuple(replace(photo, name=f"{photo.name}.jpg") for photo in collection.photos)
    wanted = save_mask(tmp_path / "masks" / "photo_0.png")
    assert with_masks_in(replace(collection, photos=photos), tmp_path / "masks").photos[0].mask.path == wanted


def test_names_in_another_form_of_unicode_are_the_same_names(collection, tmp_path):
    as_macos_writes_it = replace(collection.photos[0], name="Pla\u0308tze.png")
    collection = replace(collection, photos=(as_macos_writes_it, *collection.photos[1:]))
    mask = save_mask(tmp_path / "masks" / "Pl\u00e4tze.png")
    check_masks(tmp_path / "masks", [as_macos_writes_it.name])
    assert with_masks_in(collection, tmp_path / "masks").photos[0].mask.path == mask


def test_masks_named_as_colmap_names_them_are_found(collection, tmp_path):
    folder = tmp_path / "masks"
    wanted = [save_mask(folder / f"photo_{index}.png.png") for index in (0, 1)]
    found = with_masks_in(collection, folder)
    assert masks_of(found.photos[:2]) == wanted and not notes_with(found, "no photo in use")


def test_photos_in_folders_take_the_mask_of_their_own_folder(collection, tmp_path):
    folder = tmp_path / "masks"
    names = {"photo_0.png": "left/a.jpg", "photo_1.png": "right/a.jpg", "photo_3.png": "right/b.jpg"}
    photos = tuple(replace(photo, name=names.get(photo.name, photo.name)) for photo in collection.photos)
    wanted = [save_mask(folder / "a.png"), save_mask(folder / "right" / "a.png"), save_mask(folder / "b.tif")]
    save_mask(folder / "left" / "b.tif")  # a name that is in use elsewhere
    found = with_masks_in(replace(collection, photos=photos), folder)
    assert masks_of(photo for photo in found.photos if photo.name in names.values()) == wanted
    assert found.notes[-1].text == "1 mask of no photo in use, such as left/b.tif."
    wanted[1].unlink()
    with pytest.raises(BadInput, match="a.png may be the mask of left/a.jpg or of right/a.jpg. Name each .* such as left/a.jpg.png."):
        with_masks_in(replace(collection, photos=photos), folder)


def test_photos_named_by_whole_paths_or_through_the_folder_above_are_not_their_own_masks(collection, tmp_path):
    folder = tmp_path / "masks"
    names = [str(photo.path) for photo in collection.photos[:3]] + [f"../{photo.name}" for photo in collection.photos[3:]]
    photos = tuple(replace(photo, name=name) for photo, name in zip(collection.photos, names, strict=True))
    wanted = [save_mask(folder / f"photo_{index}.png") for index in (0, 3)]
    save_mask(folder / "passer.png")
    found = with_masks_in(replace(collection, photos=photos), folder)
    assert masks_of(photo for photo in found.photos if photo.mask) == wanted
    assert found.notes[-1].text == "1 mask of no photo in use, such as passer.png."


def test_masks_that_are_given_replace_those_of_the_scene(collection, tmp_path):
    own = {photo.name: save_mask(tmp_path / "own" / photo.name) for photo in collection.photos[:2]}
    given = save_mask(tmp_path / "masks" / "photo_1.png")
    scene = with_masks_by_name(collection, own, tmp_path / "transforms.json")
    assert masks_of(scene.photos[:3]) == [own["photo_0.png"], own["photo_1.png"], None]
    found = with_masks_in(scene, tmp_path / "masks")
    assert masks_of(found.photos[:3]) == [None, given, None]
    assert found.notes[-1].text == "The masks that the scene itself gives are not used."


def test_a_folder_that_may_not_be_read_is_not_called_empty(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "listdir", failing(DENIED))
    with pytest.raises(PermissionError):
        check_masks(tmp_path, ())


def test_what_cannot_be_meant_is_refused(collection, tmp_path):
    folder = tmp_path / "masks"
    with pytest.raises(BadInput, match="no folder .*nowhere"):
        check_masks(tmp_path / "nowhere", ())
    with pytest.raises(BadInput, match="holds no pictures"):
        check_masks(folder, ())
    check_masks(save_mask(tmp_path / "deep" / "left" / "0.png").parents[1], ())
    check_masks(tmp_path / "deep" / "left", ["0.jpg"])
    for place, photo in (("deep", "0.jpg"), ("deep/left", "1.jpg")):
        with pytest.raises(BadInput, match=f"no mask of a training photo.*such as {photo[0]}.png"):
            check_masks(tmp_path / place, [photo])
    (tmp_path / "photos").mkdir()
    save(tmp_path / "photos" / "0.jpg", noise())
    with pytest.raises(BadInput, match="photos.0.jpg is none: "):
        check_masks(tmp_path / "photos", ["0.jpg"])
    save_mask(tmp_path / "photos" / "1.png")
    check_masks(tmp_path / "photos", ["0.jpg", "1.jpg"])  # one of them may be damaged
    save_mask(folder / "0.png")
    save_mask(folder / "0.jpg")  # of no photo, so that nothing has to be chosen
    save_mask(folder / "photo_2.png")
    with pytest.raises(BadInput, match="no mask of a training photo.*such as photo_0.png"):
        with_masks_in(collection, folder)
    save_mask(folder / "photo_0.png")
    save_mask(folder / "photo_0.jpg")
    with pytest.raises(BadInput, match="photo_0.jpg and photo_0.png are masks of one photo"):
        with_masks_in(collection, folder)


def test_photos_given_as_masks_are_refused(collection, tmp_path):
    for photo in collection.photos:
        save(tmp_path / "masks" / photo.name, noise(photo.camera.height, photo.camera.width))
    with pytest.raises(BadInput, match="The mask .*photo_0.png is none: .* White"):
        with_masks_in(collection, tmp_path / "masks")


def test_a_mask_of_another_shape_is_no_mask_of_the_photo(collection, tmp_path):
    for number, sides in {0: (17, 24), 1: (8, 99), 3: (48, 36)}.items():  # the first half the size, as near as whole pixels are
        save_mask(tmp_path / "masks" / f"photo_{number}.png", *sides, np.s_[:3])
    found = with_masks_in(collection, tmp_path / "masks")
    assert [photo.mask is not None for photo in found.photos[:2]] == [True, False]
    on_its_side = notes_with(found, "1 photo with a mask on its side, used whole (turn it as EXIF turns the photo): photo_3.png")
    assert on_its_side and notes_with(found, "1 photo with a mask of another shape, used whole: photo_1.png")
    with pytest.raises(BadInput, match="photo_1.png is 99 x 8 px, its photo 48 x 36: of another shape"):
        check_fits(tmp_path / "masks" / "photo_1.png", (99, 8), (48, 36))


def test_damaged_masks_of_training_photos_are_named_and_the_others_used(collection, tmp_path):
    folder = tmp_path / "masks"
    for number in (0, 2):  # 2 is held out
        save_mask(folder / f"photo_{number}.png").write_bytes(b"no picture")
    with pytest.raises(BadInput, match="No mask in .* can be used: 1 photo with a damaged mask.*: photo_0.png .is not.*; 3 photos without"):
        with_masks_in(collection, folder)
    wanted = save_mask(folder / "photo_1.png")
    found = with_masks_in(collection, folder)
    assert masks_of(found.photos) == [None, wanted, None, None, None, None]
    assert notes_with(found, "damaged mask") == ["1 photo with a damaged mask, used whole: photo_0.png (is not a photo that can be read)"]


def test_a_mask_that_is_missing_is_called_so(collection, tmp_path):
    """One whose name is too long for the disk as well."""
    given = {"photo_0.png": tmp_path / ("m" * 300), "photo_1.png": tmp_path / "gone.png"}
    found = with_masks_by_name(collection, given, tmp_path)
    assert found.photos[0].mask is None and not notes_with(found, "with a mask")
    missing = f"photo_0.png ({given['photo_0.png']}), photo_1.png ({given['photo_1.png']})"
    assert found.notes[-2].text == f"2 photos whose mask is missing, used whole: {missing}"
    with pytest.raises(BadInput, match="The mask .*gone.png cannot be opened"):
        load_photo(replace(found.photos[1], mask=GivenMask(tmp_path / "gone.png")), 48, 36)


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
    np.testing.assert_array_equal(load_photo(replace(photo_at(path, 48, 36), mask=GivenMask(mask)), 48, 36).valid, expected)


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
    assert np.array_equal(load_photo(replace(photo_at(path, 44, 30), mask=GivenMask(mask)), 44, 30).valid, alpha[..., 0] == 255)


def test_what_is_neither_black_nor_white_is_no_mask(tmp_path):
    path, photo = save(tmp_path / "a.png", noise()), save(tmp_path / "m.png", noise())
    red = save(tmp_path / "r.png", np.full((30, 44, 3), (0, 0, 255), np.uint8))
    for mask in (photo, red):
        with pytest.raises(BadInput, match=rf"The mask .*{mask.name} is none: \d+% .* neither black nor white. White \(255\)"):
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
    own = with_mask(photo, save(tmp_path / "own.png", copy[..., 0]), (width + 8, height + 6), lens)  # drawn on the copy, whose size tells
    assert own.mask.lens is None and (~load_photo(own, width + 8, height + 6).valid == disc).all()


def test_through_which_lens_a_mask_was_taken_is_kept_with_the_run(collection, tmp_path):
    mask, lens = save_mask(tmp_path / "masks" / "photo_0.png", 72, 96), Lens("SIMPLE_RADIAL", 96, 72, [1, 2, 3, 4])
    first = with_mask(collection.photos[0], mask, (96, 72), lens)
    collection = replace(collection, photos=(first, *collection.photos[1:]))
    run_folders.create(tmp_path / "run", collection, small_settings())
    before = run_config.read_config(tmp_path / "run")[2]
    assert before.photos[0].mask.lens == lens and before.photos[1].mask is None
    bare = replace(collection, photos=(replace(first, mask=None), *collection.photos[1:]))
    again = with_same_masks(bare, before).photos[0]
    assert (again.mask.path, again.mask.lens) == (mask, lens)
    mask.unlink()
    with pytest.raises(BadInput, match="1 mask of the run cannot be found"):
        with_same_masks(bare, before)
    held_out = replace(before, photos=(replace(before.photos[0], split="test"), *before.photos[1:]))
    assert with_same_masks(bare, held_out).photos[0].mask.path == mask  # training never asks for it
