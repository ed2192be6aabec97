"""Masks that the user gives: found by name, said, and kept with the run. How they lie on photos: data/photos/test_masked."""

import os
from dataclasses import replace

import numpy as np
import pytest

from core.data.collection import GivenMask
from core.data.given_masks import (
    check_fits,
    check_masks,
    with_mask,
    with_masks_by_name,
    with_masks_in,
    with_same_masks,
)
from core.data.photos.pixels import load_photo
from core.errors import BadInput
from core.run import run_config, run_folders
from core.scene.lens import Lens
from tests.data.checks import notes_with, texts_of
from tests.data.photos.test_masked import save_mask
from tests.data.photos.test_pixels import noise, save
from tests.failing import DENIED, failing
from tests.small import small_collection, small_settings


@pytest.fixture
def collection(tmp_path):
    """photo_0 to photo_5; 2 and 5 are held out."""
    (tmp_path / "masks").mkdir()
    return small_collection(tmp_path)


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
    assert [photo.mask and photo.mask.path.name for photo in found.photos] == [
        "photo_0.jpg",
        "photo_1.bmp",
        "photo_2.png",
        None,
        None,
        None,
    ]
    assert all(photo.mask is None for photo in found.split("test"))
    assert texts_of(found.notes) == [
        f"2 photos with a mask from {folder}.",
        "1 photo with a mask of another size, which is resized: photo_1.png",
        "2 photos without a mask, used whole: photo_3.png, photo_4.png",
        "1 mask of no photo in use, such as passer.png.",
    ]
    again = with_same_masks(collection, found)
    assert [tuple(vars(photo).values()) for photo in again.photos] == [
        tuple(vars(photo).values()) for photo in found.photos
    ]


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
    with pytest.raises(
        BadInput, match="a.png may be the mask of left/a.jpg or of right/a.jpg. Name each .* such as left/a.jpg.png."
    ):
        with_masks_in(replace(collection, photos=photos), folder)


def test_photos_named_by_whole_paths_or_through_the_folder_above_are_not_their_own_masks(collection, tmp_path):
    folder = tmp_path / "masks"
    names = [str(photo.path) for photo in collection.photos[:3]] + [
        f"../{photo.name}" for photo in collection.photos[3:]
    ]
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


def test_photos_that_differ_in_their_suffixes_alone_each_have_the_mask_of_their_whole_name(collection, tmp_path):
    folder, names = tmp_path / "masks", ["a.png", "a.jpg", "a.tif", "b.png", "c.png", "d.png"]
    photos = tuple(replace(photo, name=name) for photo, name in zip(collection.photos, names, strict=True))
    wanted = [save_mask(folder / name) for name in names[:2]]
    found = with_masks_in(replace(collection, photos=photos), folder)
    assert masks_of(found.photos) == [*wanted, None, None, None, None]


def test_what_structure_from_motion_calls_a_photo_changes_none_of_its_masks(collection, tmp_path):
    """Beside an a.jpg, it makes an a.png.jpg of an a.png."""
    names = ["a.jpg", "a.png.jpg", "b.png", "c.png", "d.png", "e.png"]
    photos = tuple(replace(photo, name=name) for photo, name in zip(collection.photos, names, strict=True))
    wanted = [save_mask(tmp_path / "masks" / name) for name in ("a.jpg", "a.png")]
    check_masks(tmp_path / "masks", ["a.jpg", "a.png"])
    assert masks_of(with_masks_in(replace(collection, photos=photos), tmp_path / "masks").photos[:2]) == wanted


def test_two_masks_of_one_photo_are_refused_before_cameras_are_found(tmp_path):
    for name in ("0.jpg", "0.png"):
        save_mask(tmp_path / name)
    with pytest.raises(BadInput, match="0.jpg and 0.png are masks of one photo|0.png and 0.jpg are masks of one photo"):
        check_masks(tmp_path, ["0.jpg"])


def test_a_mask_of_another_shape_is_no_mask_of_the_photo(collection, tmp_path):
    # The first half the size, as near as whole pixels are.
    for number, sides in {0: (17, 24), 1: (8, 99), 3: (48, 36)}.items():
        save_mask(tmp_path / "masks" / f"photo_{number}.png", *sides, np.s_[:3])
    found = with_masks_in(collection, tmp_path / "masks")
    assert [photo.mask is not None for photo in found.photos[:2]] == [True, False]
    on_its_side = notes_with(
        found, "1 photo with a mask on its side, used whole (turn it as EXIF turns the photo): photo_3.png"
    )
    assert on_its_side and notes_with(found, "1 photo with a mask of another shape, used whole: photo_1.png")
    with pytest.raises(BadInput, match="photo_1.png is 99 x 8 px, its photo 48 x 36: of another shape"):
        check_fits(tmp_path / "masks" / "photo_1.png", (99, 8), (48, 36))


def test_damaged_masks_of_training_photos_are_named_and_the_others_used(collection, tmp_path):
    folder = tmp_path / "masks"
    for number in (0, 2):  # 2 is held out
        save_mask(folder / f"photo_{number}.png").write_bytes(b"no picture")
    with pytest.raises(
        BadInput,
        match="No mask in .* can be used: 1 photo with a damaged mask: photo_0.png .is not.*; 3 photos without a mask: ",
    ):
        with_masks_in(collection, folder)
    wanted = save_mask(folder / "photo_1.png")
    found = with_masks_in(collection, folder)
    assert masks_of(found.photos) == [None, wanted, None, None, None, None]
    assert notes_with(found, "damaged mask") == [
        "1 photo with a damaged mask, used whole: photo_0.png (is not a photo that can be read)"
    ]


def test_a_mask_that_is_missing_is_called_so(collection, tmp_path):
    """One whose name is too long for the disk as well."""
    given = {"photo_0.png": tmp_path / ("m" * 300), "photo_1.png": tmp_path / "gone.png"}
    found = with_masks_by_name(collection, given, tmp_path)
    assert found.photos[0].mask is None and not notes_with(found, "with a mask")
    missing = f"photo_0.png ({given['photo_0.png']}), photo_1.png ({given['photo_1.png']})"
    assert found.notes[-2].text == f"2 photos whose mask is missing, used whole: {missing}"
    with pytest.raises(BadInput, match="The mask .*gone.png cannot be opened"):
        load_photo(replace(found.photos[1], mask=GivenMask(tmp_path / "gone.png")), 48, 36)


def test_through_which_lens_a_mask_was_taken_is_kept_with_the_run(collection, tmp_path):
    mask, lens = save_mask(tmp_path / "masks" / "photo_0.png", 72, 96), Lens("SIMPLE_RADIAL", 96, 72, [1, 2, 3, 4])
    first = with_mask(collection.photos[0], mask, (96, 72), lens)
    collection = replace(collection, photos=(first, *collection.photos[1:]))
    run_folders.create(tmp_path / "run", collection, small_settings())
    before = run_config.read_config(tmp_path / "run").collection
    assert before.photos[0].mask.lens == lens and before.photos[1].mask is None
    bare = replace(collection, photos=(replace(first, mask=None), *collection.photos[1:]))
    again = with_same_masks(bare, before).photos[0]
    assert (again.mask.path, again.mask.lens) == (mask, lens)
    mask.unlink()
    with pytest.raises(BadInput, match="1 mask of the run cannot be found"):
        with_same_masks(bare, before)
    held_out = replace(before, photos=(replace(before.photos[0], split="test"), *before.photos[1:]))
    assert with_same_masks(bare, held_out).photos[0].mask.path == mask  # training never asks for it
