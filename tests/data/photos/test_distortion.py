"""Distorted photos: undistorted pixels lie where the pinhole camera says,
and those that the photo does not show are invalid."""

import cv2
import numpy as np
import pycolmap
import pytest
from PIL import Image

from core.data import load_collection
from core.data.collection import Photo
from core.data.photos import distortion
from core.data.photos.file import ORIENTATION
from core.data.photos.pixels import load_photo
from core.errors import BadInput
from core.scene.camera import Camera
from tests.data.checks import notes_with
from tests.data.small_scene import HEIGHT, LENSES, WIDTH, SmallScene, add_exif, centroid, exif_block

# A dot is stretched by up to 10 % over its width of 2 px, cubic interpolation and 8 bits add 0.02 px.
ALIGNED_PX = 0.1


def check_dots(collection, index, least):
    """All points well inside the photo have their dot where the collection's camera projects them; at both sizes."""
    photo = collection.photos[index]
    for divisor in (1, 3):  # 3: shrunk before it is undistorted, and once more after
        camera = photo.camera.resized(photo.camera.width // divisor, photo.camera.height // divisor)
        loaded = load_photo(photo, camera.width, camera.height)
        assert loaded.pixels.shape == (camera.height, camera.width, 3)
        pixels, _ = camera.project(collection.points)
        reach = 7 / divisor * max(photo.camera.width, photo.camera.height) / WIDTH
        inside = ((pixels > reach) & (pixels < (camera.width - reach, camera.height - reach))).all(axis=1)
        assert inside.sum() >= least
        for dot in pixels[inside]:
            assert np.abs(centroid(loaded.pixels, dot, reach) - dot).max() < ALIGNED_PX


@pytest.mark.parametrize("model", LENSES)
def test_undistorted_dots_lie_where_the_pinhole_projects_them(tmp_path, model):
    scene = SmallScene(model=model)
    collection = load_collection(scene.write(tmp_path / "scene"))
    check_dots(collection, 1, least=12)
    photo = collection.photos[1]
    pinhole, _ = photo.camera.project(collection.points)
    moved_px = np.abs(scene.seen(1) - pinhole).max()
    assert (photo.lens is None) == (moved_px < distortion.NEGLIGIBLE_PX) == model.endswith("PINHOLE")


@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV"])
def test_photos_of_twice_the_models_size(tmp_path, model):
    collection = load_collection(SmallScene(model=model, scale=2.0).write(tmp_path / "scene"))
    assert collection.photos[0].camera.width == 2 * WIDTH
    check_dots(collection, 2, least=12)


@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV"])
@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_exif_rotation_turns_the_camera_along(tmp_path, model, orientation):
    """COLMAP ignores EXIF rotation, so its model describes the pixels as stored; they are displayed turned."""
    root = SmallScene(model=model).write(tmp_path / "scene")
    add_exif(root / "images" / "photo_1.png", exif_block(orientation))
    collection = load_collection(root)
    camera = collection.photos[1].camera
    assert (camera.width < camera.height) == (orientation != 3)
    assert "photo_1.png" in notes_with(collection, "turned by EXIF orientation")[0]
    check_dots(collection, 1, least=12)


@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV"])
@pytest.mark.parametrize("compression", ["raw", "tiff_lzw"])
@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_a_tiff_is_turned_along_as_well(tmp_path, model, compression, orientation):
    """Pillow turns it when it decodes it; COLMAP does not."""
    root = SmallScene(model=model, names=["photo_0.png", "photo_1.tif"]).write(tmp_path / "scene")
    path = root / "images" / "photo_1.tif"
    write_tiff(path, cv2.imread(str(path)), orientation, compression)
    assert pycolmap.Bitmap.read(str(path), True).to_array().shape == (HEIGHT, WIDTH, 3)
    collection = load_collection(root)
    assert "photo_1.tif" in notes_with(collection, "turned by EXIF orientation")[0]
    check_dots(collection, 1, least=12)


def test_a_mirrored_tiff_is_left_out(tmp_path):
    root = SmallScene(names=["photo_0.png", "photo_1.tif"]).write(tmp_path / "scene")
    path = root / "images" / "photo_1.tif"
    write_tiff(path, cv2.imread(str(path)), 2)
    assert "photo_1.tif" in notes_with(load_collection(root), "mirrored by EXIF orientation")[0]


def write_tiff(path, pixels, orientation, compression="raw"):
    Image.fromarray(pixels).save(path, tiffinfo={ORIENTATION: orientation}, compression=compression)


def test_models_made_from_upright_pixels_are_recognised_by_their_size(tmp_path):
    """Where another program made the model from displayed pixels, only their size fits."""
    root = SmallScene(model="SIMPLE_RADIAL").write(tmp_path / "scene")
    path = root / "images" / "photo_1.png"
    stored = cv2.rotate(cv2.imread(str(path)), cv2.ROTATE_90_COUNTERCLOCKWISE)
    assert cv2.imwrite(str(path), stored)
    add_exif(path, exif_block(6))
    check_dots(load_collection(root), 1, least=12)


def picture_through(model, params, fill=200):
    lens = pycolmap.Camera(model=model, width=WIDTH, height=HEIGHT, params=params)
    camera = Camera(np.eye(3), np.zeros(3), *distortion.pinhole(lens, WIDTH, HEIGHT), WIDTH, HEIGHT)
    pixels = np.full((HEIGHT, WIDTH, 3), fill, np.uint8)
    return distortion.undistort(pixels, distortion.lens_of(lens), camera)


def test_barrel_lenses_fill_the_picture():
    _, valid = picture_through("SIMPLE_RADIAL", [150.0, 80, 60, -0.1])
    assert valid.all()


def test_cushion_lenses_leave_the_corners_invalid():
    picture, valid = picture_through("SIMPLE_RADIAL", [150.0, 80, 60, 0.2])
    assert not valid[0, 0] and not valid[-1, -1] and valid[60, 80] and 0.8 < valid.mean() < 1
    assert (picture[valid] == 200).all()


def test_lens_formulas_that_fold_over_are_cut_at_the_fold():
    """r (1 - r^2 / 2) turns back at r = 0.816 and mirrors the picture beyond r = 1.41:
    nothing beyond the fold is valid."""
    focal = 60.0
    _, valid = picture_through("SIMPLE_RADIAL", [focal, 80, 60, -0.5])
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    radius = np.hypot(x - 80, y - 60) / focal
    assert not valid[radius > np.sqrt(2 / 3) + 0.02].any()  # 0.02 is about a pixel
    assert valid[radius < np.sqrt(2 / 3) - 0.05].all()  # right at the fold Newton's method may not converge


def test_a_fold_within_a_ring_is_cut_out_as_if_every_pixel_were_led_back(monkeypatch):
    """r (1 - 1.1 r^2 + 0.54 r^4) falls between r = 0.75 and 0.81 only; the corners, at 1.43, can be led back."""
    _, valid = picture_through("RADIAL", [70.0, 80, 60, -1.1, 0.54])
    assert valid[[0, 0, -1, -1], [0, -1, 0, -1]].all() and valid[60, 80] and not valid.all()
    monkeypatch.setattr(distortion, "NEGLIGIBLE_PX", 0.0)
    assert np.array_equal(valid, picture_through("RADIAL", [70.0, 80, 60, -1.1, 0.54])[1])


@pytest.mark.parametrize("strength, pixels", [(-0.05, 0), (-0.5, WIDTH * HEIGHT)])
def test_only_of_lenses_that_fold_every_pixel_is_led_back(monkeypatch, strength, pixels):
    led_back, colmap_camera = [], distortion.colmap_camera

    class Watched:
        def __init__(self, lens):
            self.img_from_cam, self.model = colmap_camera(lens).img_from_cam, colmap_camera(lens)

        def cam_from_img(self, seen):
            led_back.append(len(seen))
            return self.model.cam_from_img(seen)

    monkeypatch.setattr(distortion, "colmap_camera", Watched)
    picture_through("SIMPLE_RADIAL", [60.0, 80, 60, strength])
    assert sum(led_back) == distortion.NODES**2 + pixels


def test_large_pictures_are_done_in_blocks(monkeypatch):
    whole = picture_through("OPENCV", LENSES["OPENCV"])
    monkeypatch.setattr(distortion, "BLOCK_PIXELS", 7 * WIDTH)
    parts = picture_through("OPENCV", LENSES["OPENCV"])
    assert (whole[0] == parts[0]).all() and (whole[1] == parts[1]).all()


def test_a_picture_larger_than_opencv_remaps_is_refused_unless_it_is_shrunk(tmp_path):
    width, height = distortion.LARGEST_REMAPPED_PX + 2, 8
    Image.new("L", (width, height)).save(tmp_path / "wide.png")
    lens = pycolmap.Camera(
        model="SIMPLE_RADIAL", width=width, height=height, params=[width, width / 2, height / 2, -0.1]
    )
    camera = Camera(np.eye(3), np.zeros(3), *distortion.pinhole(lens, width, height), width, height)
    photo = Photo("wide.png", tmp_path / "wide.png", camera, "train", lens=distortion.lens_of(lens))
    with pytest.raises(BadInput, match=r"A picture of 32768 x 8 px is too large to be undistorted\. .*-r 4"):
        load_photo(photo, width, height)
    assert load_photo(photo, width // 4, height // 4).pixels.shape == (height // 4, width // 4, 3)


@pytest.mark.parametrize("strength, folds", [(-1.6, True), (-0.6, True), (-0.05, False), (0.0, False), (0.4, False)])
def test_a_lens_folds_over_where_no_ray_leads_to_the_edge(strength, folds):
    """Rays at r = 1 / sqrt(-3 k) are drawn farthest out, at two thirds of r; a corner lies at 1."""
    assert (
        distortion.folds_over(
            pycolmap.Camera(model="SIMPLE_RADIAL", width=160, height=120, params=[100, 80, 60, strength])
        )
        == folds
    )


@pytest.mark.parametrize("name", LENSES)
def test_usual_lenses_do_not_fold_over(name):
    assert not distortion.folds_over(SmallScene(model=name).lens())
