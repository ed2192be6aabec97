"""Structure from motion: from photos of a room corner, made here, back to the cameras that took them."""

import errno
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from core.data import load_collection
from core.data.photos.distortion import colmap_camera
from core.data.photos.folder import list_photos
from core.data.photos.pixels import load_photo, read_pixels_and_alpha
from core.data.sfm import originals
from core.data.sfm.originals import name_in
from core.data.sfm.reconstruct import copy_upright, give_alpha, reconstruct
from core.errors import BadInput, WegsError
from core.report import Report
from core.scene.lens import Lens
from core.system.atomic import replacing_folder
from tests.data.room_corner import HEIGHT, WIDTH, cameras, save_corner, take_photo, textures
from tests.data.small_scene import add_exif, exif_block
from tests.failing import DISK_FULL, failing
from tests.heard import Heard


def aligned(found, truth):
    """`found` (N, 3) moved, turned and scaled onto `truth` (Umeyama 1991)."""
    a, b = found - found.mean(axis=0), truth - truth.mean(axis=0)
    u, s, v = np.linalg.svd(b.T @ a)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ v))])
    return (a @ (u @ sign @ v).T) * np.trace(np.diag(s) @ sign) / (a**2).sum() + truth.mean(axis=0)


def noise_photo(path, seed, cells=(60, 80)):
    noise = np.random.default_rng(seed).integers(0, 256, (*cells, 3), np.uint8)
    assert cv2.imwrite(str(path), cv2.resize(noise, (WIDTH, HEIGHT)))


def test_cameras_are_found_again(tmp_path):
    """With a turned photo, a PNG, a JPEG that is called a WebP, a name with a space, one that is transparent on the
    left; a truncated photo and a stranger are left out."""
    photos = tmp_path / "photos"
    photos.mkdir()
    pictures, names, centres = (
        textures(),
        ["000002.jpg", "000003.jpg", "000004.webp", "a b.jpg", "b.png", "c.jpg", "d.png"],
        [],
    )
    for name, (rotation, centre) in zip(names, cameras(len(names)), strict=True):
        kind = ".jpg" if name == "000004.webp" else Path(name).suffix
        (photos / name).write_bytes(cv2.imencode(kind, take_photo(rotation, centre, pictures))[1].tobytes())
        centres.append(centre)
    turned = cv2.rotate(cv2.imread(str(photos / "c.jpg")), cv2.ROTATE_90_COUNTERCLOCKWISE)
    assert cv2.imwrite(str(photos / "c.jpg"), turned, [cv2.IMWRITE_JPEG_QUALITY, 100])
    add_exif(photos / "c.jpg", exif_block(6))
    alpha = np.full((HEIGHT, WIDTH, 1), 255, np.uint8)
    alpha[:, : WIDTH // 4] = 0
    assert cv2.imwrite(str(photos / "d.png"), np.dstack([cv2.imread(str(photos / "d.png")), alpha]))
    (photos / "test.txt").write_text("b\n")
    (photos / "cut.jpg").write_bytes((photos / "a b.jpg").read_bytes()[:3000])
    noise_photo(photos / "stranger.png", 0)

    heard = Heard()
    scene = reconstruct(photos, tmp_path / "new" / "scene", heard, lists=[photos])
    assert any("cut.jpg" in line and "truncated" in line for line in heard.lines)
    assert any("that got no place, left out" in line and line.endswith("stranger.png") for line in heard.lines)
    assert "1 photo turned upright, as EXIF says." in heard.lines
    assert heard.finished >= {"Photos", "Features", "Matches"}
    assert [entry.name for entry in (tmp_path / "new").iterdir()] == ["scene"]
    files = ["images", "lenses.json", "lists.json", "names.json", "photos.json", "sparse", "test.txt"]
    assert sorted(entry.name for entry in scene.iterdir()) == files

    collection = load_collection(scene)
    assert [photo.name for photo in collection.split("test")] == ["b.png.jpg"]
    assert [name_in(scene, photos / name) for name in names] == [photo.name for photo in collection.photos]
    assert [photo.name for photo in collection.photos] == [
        "000002.jpg",
        "000003.jpg",
        "000004.webp.jpg",
        "a b.jpg",
        "b.png.jpg",
        "c.jpg",
        "d.png",
    ]
    lenses = originals.lenses_of(scene)
    assert lenses.keys() == {photo.name for photo in collection.photos}
    assert all((lens.model, lens.width, lens.height) == ("SIMPLE_RADIAL", WIDTH, HEIGHT) for lens in lenses.values())
    assert all(photo.lens is None and photo.camera.width > photo.camera.height for photo in collection.photos)
    found = aligned(np.array([photo.camera.centre for photo in collection.photos]), np.array(centres))
    # 0.01 was seen; focal lengths and distortion are estimated as well, and threads make it vary. The arc is 1.8 long.
    assert np.abs(found - centres).max() < 0.05
    # The photos were held level, and the scene stands upright: what is right in a photo is at right angles to down,
    # which is +y.
    assert max(abs(photo.camera.world_to_camera[0, 1]) for photo in collection.photos) < 0.01
    given = [cv2.resize(cv2.imread(str(photos / name)), (32, 24), interpolation=cv2.INTER_AREA) for name in names[:5]]
    for index, photo in enumerate(collection.photos[:5]):  # each still its own picture
        apart = [np.abs(load_photo(photo, 32, 24).pixels[..., ::-1] - one.astype(float)).mean() for one in given]
        assert np.argmin(apart) == index
    opaque = load_photo(collection.photos[6], 320, 240).valid
    assert not opaque[:, :70].any() and opaque[:, 90:].all()
    empty = load_photo(collection.photos[6], 320, 240, transparent_is_empty=True).empty
    assert (empty[:, :70] == 255).all() and not empty[:, 90:].any()
    os.utime(photos / "b.png", ns=(1, 1))
    assert name_in(scene, photos / "b.png") is None  # changed since


def test_what_is_half_transparent_is_laid_over_white_once(tmp_path):
    """COLMAP undistorts the photo as it is over white, and readers lay what is transparent over white again."""
    shown = np.random.default_rng(0).integers(200, 256, (HEIGHT, WIDTH, 3), np.uint8)
    alpha = np.random.default_rng(1).integers(64, 256, (HEIGHT, WIDTH), np.uint8)
    picture, opacity = tmp_path / "picture.png", tmp_path / "alpha.png"
    assert cv2.imwrite(str(picture), shown) and cv2.imwrite(str(opacity), alpha)
    lens = Lens("SIMPLE_PINHOLE", WIDTH, HEIGHT, [WIDTH, WIDTH / 2, HEIGHT / 2])
    give_alpha(picture, colmap_camera(lens), opacity, lens)
    pixels, found = read_pixels_and_alpha(picture)
    assert np.array_equal(found, alpha)
    assert np.abs(pixels[..., ::-1].astype(int) - shown).max() <= 1  # rounded


def test_the_same_photos_give_the_same_scene(tmp_path):
    photos = save_corner(tmp_path / "photos", [f"{number}.jpg" for number in range(5)])
    first, second = (reconstruct(photos, tmp_path / name, Report()) / "sparse" / "0" for name in ("first", "second"))
    assert {path.name: path.read_bytes() for path in first.iterdir()} == {
        path.name: path.read_bytes() for path in second.iterdir()
    }


def test_photos_that_do_not_overlap_are_refused(tmp_path):
    for seed in range(3):
        noise_photo(tmp_path / f"{seed}.jpg", seed)
    with pytest.raises(BadInput, match="No cameras could be found: the 3 photos"):
        reconstruct(tmp_path, tmp_path / "scene", Report())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0.jpg", "1.jpg", "2.jpg"]


def test_one_photo_is_too_few(tmp_path):
    noise_photo(tmp_path / "0.jpg", 0)
    with pytest.raises(BadInput, match="holds 1 photo that can be used"):
        reconstruct(tmp_path, tmp_path / "scene", Report())


def test_a_folder_without_photos_is_refused(tmp_path):
    with pytest.raises(BadInput, match="holds 0 photos that can be used"):
        reconstruct(tmp_path, tmp_path / "scene", Report())


def test_an_output_that_exists_is_left_alone(tmp_path):
    noise_photo(tmp_path / "0.jpg", 0)
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "mine.txt").write_text("precious")
    with pytest.raises(BadInput, match="scene exists and is not an empty folder. Choose another -o.$"):
        reconstruct(tmp_path, tmp_path / "scene", Report())
    assert (tmp_path / "scene" / "mine.txt").read_text() == "precious"
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="file is not a folder"):
        reconstruct(tmp_path, tmp_path / "file" / "scene", Report())
    (tmp_path / "link").symlink_to(tmp_path / "nothing")
    with pytest.raises(BadInput, match="link is not a folder"):
        reconstruct(tmp_path, tmp_path / "link", Report())


def test_a_scene_made_by_another_meanwhile_is_left_alone(tmp_path):
    theirs = tmp_path / "scene" / "theirs.txt"
    with (
        pytest.raises(BadInput, match="scene was made by another program meanwhile"),
        replacing_folder(theirs.parent) as work,
    ):
        (work / "scene").mkdir()
        theirs.parent.mkdir()
        theirs.write_text("precious")
    assert list(tmp_path.iterdir()) == [theirs.parent] and theirs.read_text() == "precious"


def test_an_empty_folder_that_another_program_filled_meanwhile_is_left_alone(tmp_path):
    theirs = tmp_path / "photos.json"
    with pytest.raises(BadInput, match="was made by another program meanwhile"), replacing_folder(tmp_path) as work:
        (work / "scene").mkdir()
        (work / "scene" / theirs.name).write_text("ours")
        theirs.write_text("precious")
    assert list(tmp_path.iterdir()) == [theirs] and theirs.read_text() == "precious"


def test_a_list_that_cannot_be_read_is_noticed_before_the_work(tmp_path):
    photos = tmp_path / "photos"
    photos.mkdir()
    noise_photo(photos / "0.jpg", 0)
    (photos / "test.txt").write_text("0.jpg\n")
    with pytest.MonkeyPatch.context() as patch, pytest.raises(PermissionError):
        patch.setattr(
            "core.data.split.digest",
            failing(PermissionError(errno.EACCES, "Permission denied", str(photos / "test.txt"))),
        )
        reconstruct(photos, tmp_path / "scene", Report(), lists=[photos])
    assert list(tmp_path.iterdir()) == [photos]


def test_an_empty_folder_is_filled_from_within(tmp_path):
    """It may be a disk of its own: it can be neither removed nor moved onto."""
    with replacing_folder(tmp_path) as work:
        assert work.parent == tmp_path
        for part in ("images", "sparse"):
            (work / "scene" / part).mkdir(parents=True)
        (work / "scene" / "photos.json").touch()
    assert {path.name for path in tmp_path.iterdir()} == {"images", "sparse", "photos.json"}


def test_the_model_comes_last_into_a_folder_that_is_there(tmp_path, monkeypatch):
    """Until then the folder is no scene, however the disk lists its parts."""
    listed, put, replaced = Path.iterdir, os.replace, []
    monkeypatch.setattr(Path, "iterdir", lambda folder: iter(sorted(listed(folder), reverse=True)))
    monkeypatch.setattr(os, "replace", lambda part, place: (replaced.append(Path(place).name), put(part, place)))
    with replacing_folder(tmp_path) as work:
        for name in ("sparse", "images", originals.MADE_OF, originals.NAMES, originals.LENSES, "test.txt"):
            (work / "scene" / name).mkdir(parents=True)
    assert len(replaced) == 6 and replaced[-1] == "sparse"


def test_photos_in_formats_of_phones_and_links_to_nothing_are_named(tmp_path):
    noise_photo(tmp_path / "0.jpg", 0)
    (tmp_path / "IMG_1.DNG").write_bytes(b"x")
    (tmp_path / "1.jpg").symlink_to(tmp_path / "gone.jpg")
    heard = Heard()
    with pytest.raises(BadInput, match="holds 1 photo that can be used"):
        reconstruct(tmp_path, tmp_path / "scene", heard)
    assert any("cannot be read, left out; convert them to JPEG: IMG_1.DNG" in line for line in heard.lines)
    assert "! 1 photo whose file is gone, left out: 1.jpg" in heard.lines


def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path, monkeypatch):
    for seed in range(2):
        noise_photo(tmp_path / f"{seed}.jpg", seed)
    monkeypatch.setattr(Path, "write_bytes", failing(DISK_FULL))
    with pytest.raises(WegsError, match="The disk is full"):
        reconstruct(tmp_path, tmp_path / "scene", Report())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0.jpg", "1.jpg"]


def test_damage_that_shows_only_when_decoding_leaves_a_photo_out(tmp_path):
    photos = tmp_path / "photos"
    photos.mkdir()
    noise_photo(photos / "a.jpg", 1)
    whole = (photos / "a.jpg").read_bytes()
    (photos / "b.jpg").write_bytes(whole[: len(whole) // 2] + b"\xff\xd9")
    heard = Heard()
    with pytest.raises(BadInput, match="holds 1 photo that can be used"):
        reconstruct(photos, tmp_path / "scene", heard)
    assert any("b.jpg ends before" in line for line in heard.lines)
    assert list(tmp_path.iterdir()) == [photos]


def test_a_photo_too_large_for_a_jpeg_is_left_out(tmp_path):
    noise_photo(tmp_path / "a.jpg", 1)
    assert cv2.imwrite(str(tmp_path / "b.png"), np.zeros((1, 65_501, 3), np.uint8))
    heard = Heard()
    with pytest.raises(BadInput, match="holds 1 photo that can be used"):
        reconstruct(tmp_path, tmp_path / "scene", heard)
    assert any("b.png is 65501 x 1 px, too large for a JPEG" in line for line in heard.lines)


def test_the_current_folder_cannot_become_the_scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInput, match="folder you are in"):
        reconstruct(tmp_path, Path("."), Report())


def test_a_name_too_long_for_its_jpeg_is_cut(tmp_path):
    names = ["a" * 251 + ".png", "b" * 247 + ".png"]
    for name, texture in zip(names, textures(), strict=False):
        assert cv2.imwrite(str(tmp_path / name), texture)
    (tmp_path / "work").mkdir()
    copies, _ = copy_upright(list_photos(tmp_path), tmp_path / "work", Heard())
    assert set(copies.values()) == {"1-" + ("a" * 50 + ".png.jpg"), names[1] + ".jpg"}


def test_no_two_photos_have_one_name(tmp_path):
    for name, texture in zip(("3-a.tif.jpg", "a.tif", "a.tif.jpg"), (*textures(), 255 - textures()[0]), strict=False):
        assert cv2.imwrite(str(tmp_path / name), texture)
    (tmp_path / "work").mkdir()
    copies, originals = copy_upright(list_photos(tmp_path), tmp_path / "work", Heard())
    assert len(set(copies.values())) == 3 and set(copies.values()) == set(originals.values())
    assert originals[tmp_path / "3-a.tif.jpg"] == "3-a.tif.jpg"


def test_of_a_picture_that_was_stored_again_the_fullest_is_used(tmp_path):
    """However few bytes it has; and one that cannot be used is no reason to leave out another."""
    noise_photo(tmp_path / "b.jpg", 1, cells=(12, 16))
    noise_photo(tmp_path / "c.jpg", 2, cells=(12, 16))
    whole = cv2.imread(str(tmp_path / "b.jpg"))
    half = cv2.resize(whole, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    assert cv2.imwrite(str(tmp_path / "a.png"), half) and cv2.imwrite(
        str(tmp_path / "b.jpg"), whole, [cv2.IMWRITE_JPEG_QUALITY, 60]
    )
    assert (tmp_path / "a.png").stat().st_size > (tmp_path / "b.jpg").stat().st_size
    wide = cv2.resize(whole, (65_600, 40))
    assert cv2.imwrite(str(tmp_path / "pano.png"), wide) and cv2.imwrite(
        str(tmp_path / "pano-small.jpg"), cv2.resize(wide, None, fx=0.5, fy=0.5)
    )
    (tmp_path / "work").mkdir()
    heard = Heard()
    copies, _ = copy_upright(list_photos(tmp_path), tmp_path / "work", heard)
    assert list(copies.values()) == ["b.jpg", "c.jpg", "pano-small.jpg"]
    assert "1 picture stored twice, left out: a.png is the picture b.jpg once more, with fewer pixels" in heard.lines
