"""COLMAP folders: every layout and format read alike, everything unusable left out and named."""

import os

import cv2
import numpy as np
import pycolmap
import pytest

from core.data import load_collection
from core.errors import BadInput
from tests.data.checks import check_geometry, notes_with
from tests.data.small_scene import HEIGHT, WIDTH, SmallScene, add_exif, exif_block


@pytest.mark.parametrize(
    ("images", "sparse", "scale"),
    [
        ("images", "sparse/0", 1.0),
        ("images", "sparse", 1.0),
        ("dense/images", "dense/sparse", 1.0),
        ("dense/images", "dense/sparse/0", 1.0),
        ("dense/0/images", "dense/0/sparse", 1.0),  # COLMAP's automatic reconstructor
        ("images_2", "sparse/0", 0.5),
        ("images_4", "sparse/0", 0.25),
        ("images_8", "sparse", 0.125),
        (".", "sparse/0", 1.0),
        (".", ".", 1.0),
        ("images", ".", 1.0),
        ("dense/images_2", "dense/sparse", 0.5),
    ],
)
def test_every_layout_is_read(tmp_path, images, sparse, scale):
    scene = SmallScene(scale=scale)
    collection = load_collection(scene.write(tmp_path / "church", images, sparse))
    check_geometry(collection, scene, scale)
    assert (collection.name, collection.kind) == ("church", "colmap")
    assert collection.photos[0].camera.width == round(WIDTH * scale)
    assert collection.photos[0].camera.height == round(HEIGHT * scale)
    fuller = (tmp_path / "church" / images).parent / "images"
    assert bool(notes_with(collection, f"are used: there is no {fuller}")) == (scale < 1)


@pytest.mark.parametrize("base", [".", "dense"])
@pytest.mark.parametrize("shrunken", ["images_2", "images_8"])
def test_whole_photos_are_preferred_to_shrunken_ones(tmp_path, base, shrunken):
    root = SmallScene(scale=0.5).write(tmp_path / "scene", f"{base}/{shrunken}", f"{base}/sparse")
    SmallScene().write(tmp_path / "whole")
    (tmp_path / "whole" / "images").rename(root / base / "images")
    photos = load_collection(root).photos
    assert {photo.path.parent.name for photo in photos} == {"images"} and photos[0].camera.width == WIDTH
    photos[1].path.unlink()  # taken out: no reason to use the shrunken ones
    assert [photo.path for photo in load_collection(root).photos] == [photo.path for photo in (photos[0], *photos[2:])]


def test_an_undistorted_model_takes_the_photos_beside_it_not_the_originals_above(tmp_path):
    root = SmallScene().write(tmp_path / "scene", "dense/images", "dense/sparse")
    SmallScene(model="SIMPLE_RADIAL").write(tmp_path / "originals")
    (tmp_path / "originals" / "images").rename(root / "images")
    assert {photo.path.parent for photo in load_collection(root).photos} == {root / "dense" / "images"}


@pytest.mark.parametrize("form", ["binary", "text", "old binary", "old text"])
def test_every_format_of_model_is_read(tmp_path, form):
    """Since COLMAP 3.12 models have rigs and frames; before, they had not."""
    scene = SmallScene()
    root = scene.write(tmp_path / "scene")
    model = root / "sparse" / "0"
    if "text" in form:
        scene.in_text(root)
    if "old" in form:
        for name in ("rigs", "frames"):
            for path in model.glob(f"{name}.*"):
                path.unlink()
    collection = load_collection(root)
    check_geometry(collection, scene)
    assert np.allclose(collection.point_colours[3] * 255, (30, 252, 7))


def test_quaternions_of_another_length_turn_as_much_and_one_of_none_is_broken(tmp_path):
    scene = SmallScene()
    root = scene.write(tmp_path / "scene")
    path = scene.in_text(root) / "images.txt"

    def scaled(factor, line):
        words = line.split(" ")
        return " ".join([words[0], *(str(factor * float(word)) for word in words[1:5]), *words[5:]])

    lines = path.read_text().splitlines()
    poses = [number for number, line in enumerate(lines) if line.endswith(".png")]
    for number in poses:
        lines[number] = scaled(2, lines[number])
    path.write_text("\n".join(lines) + "\n")
    check_geometry(load_collection(root), scene)
    lines[poses[0]] = scaled(0, lines[poses[0]])
    path.write_text("\n".join(lines) + "\n")
    assert len(load_collection(root).photos) == 3 and notes_with(
        load_collection(root), "1 photo with a camera or pose that is broken"
    )


def test_rigs_of_several_cameras(tmp_path):
    options = pycolmap.SyntheticDatasetOptions()
    options.num_cameras_per_rig, options.num_frames_per_rig, options.num_points3D = 2, 2, 30
    options.camera_width, options.camera_height = WIDTH, HEIGHT
    options.camera_model_id, options.camera_params = pycolmap.CameraModelId.SIMPLE_PINHOLE, [150.0, 80.0, 60.0]
    model = pycolmap.synthesize_dataset(options)
    (tmp_path / "sparse").mkdir()
    model.write_binary(str(tmp_path / "sparse"))
    for image in model.images.values():
        path = tmp_path / "images" / image.name
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    collection = load_collection(tmp_path)
    assert len(collection.photos) == model.num_reg_images() == 8
    images = {image.name: image for image in model.images.values()}
    point_ids = sorted(model.points3D)
    for photo in collection.photos:
        pixels, _ = photo.camera.project(collection.points)
        for row in photo.points:
            expected = images[photo.name].project_point(model.points3D[point_ids[row]].xyz)
            assert np.abs(pixels[row] - expected).max() < 1e-6


def test_photos_in_folders_below(tmp_path):
    scene = SmallScene(names=["left/a.png", "left/b.png", "right/a.png"])
    check_geometry(load_collection(scene.write(tmp_path / "scene")), scene)


def test_photos_named_by_whole_paths(tmp_path):
    scene = SmallScene(names=[str(tmp_path / "elsewhere" / f"{index}.png") for index in range(4)])
    root = scene.write(tmp_path / "scene")
    (root / "images").rmdir()
    check_geometry(load_collection(root), scene)


def test_photos_named_by_ways_through_other_folders_are_not_called_without_a_pose(tmp_path):
    collection = load_collection(SmallScene(names=["../images/a.png", "./b.png"]).write(tmp_path / "scene"))
    assert len(collection.photos) == 2 and not notes_with(collection, "without a pose")


def test_photos_listed_twice_are_reported(tmp_path):
    root = SmallScene().write(tmp_path / "scene")
    SmallScene(names=["photo_0.png", "photo_1.png", "photo_1.png", "photo_3.png"]).reconstruction().write_binary(
        str(root / "sparse" / "0")
    )
    assert notes_with(load_collection(root), "1 photo of the model named more than once, used once: photo_1.png")


def test_a_photo_whose_name_is_too_long_for_the_disk_is_missing(tmp_path):
    root = SmallScene().write(tmp_path / "scene")
    model = SmallScene().reconstruction()
    model.image(1).name = "x" * 300 + ".png"
    model.write_binary(str(root / "sparse" / "0"))
    collection = load_collection(root)
    assert len(collection.photos) == 3 and notes_with(collection, "1 photo of the model missing")


def test_scene_frame_holds_georeferenced_worlds(tmp_path):
    scene = SmallScene(offset=np.array([5e5, 5e6, 100.0]))
    collection = load_collection(scene.write(tmp_path / "scene"))
    assert np.linalg.norm(collection.points, axis=1).max() < 2
    assert np.abs(collection.frame.to_world(collection.points) - (scene.points + scene.offset)).max() < 1e-8
    for photo in collection.photos:
        pixels, _ = photo.camera.project(collection.points)
        # 5e6 has 1e-9 left in float64, and world units are 50 px here.
        assert np.abs(pixels - scene.seen(scene.names.index(photo.name))).max() < 1e-5


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
def test_photos_whose_names_are_not_utf_8_are_reported_and_the_others_used(tmp_path, suffix):
    scene = SmallScene(names=["a.png", "bé.png", "c.png"])
    root = scene.write(tmp_path / "scene")
    model = root / "sparse" / "0"
    if suffix == ".txt":
        scene.in_text(root)
    latin = b"b\xe9_.png"  # of as many bytes
    images = model / f"images{suffix}"
    images.write_bytes(images.read_bytes().replace("bé.png".encode(), latin))
    (root / "images" / "bé.png").rename(root / "images" / os.fsdecode(latin))
    collection = load_collection(root)
    assert [photo.name for photo in collection.photos] == ["a.png", "c.png"] and len(collection.photos[1].points) == 20
    assert notes_with(collection, "1 photo of the model whose name is not in UTF-8, not used: b\udce9_.png")
    assert not notes_with(collection, "without a pose")
    images.write_bytes(images.read_bytes().replace(b"a.png", b"\xe9.png"[:5]).replace(b"c.png", b"\xe8.png"))
    with pytest.raises(BadInput, match="has no photos with a pose: 3 photos of the model whose name is not in UTF-8"):
        load_collection(root)


def test_cameras_far_from_all_others_are_reported_and_used(tmp_path):
    def move(model):
        pose = model.images[2].cam_from_world()
        model.images[2].frame.rig_from_world = pycolmap.Rigid3d(pose.rotation, pose.translation + [0, 0, 900.0])

    collection = load_collection(rewritten(tmp_path, move))
    assert notes_with(
        collection, "1 photo whose camera stands over 100 times as far off as is usual, used all the same: photo_1.png"
    )
    assert len(collection.photos) == 4


@pytest.mark.parametrize("images", ["images", "images_2", "input"])
def test_missing_photos_are_named_and_the_others_used_even_if_few(tmp_path, images):
    root = SmallScene().write(tmp_path / "scene", images)
    (root / images / "photo_2.png").unlink()
    collection = load_collection(root)
    assert [photo.name for photo in collection.photos] == ["photo_0.png", "photo_1.png", "photo_3.png"]
    assert notes_with(collection, "1 photo of the model missing in ")[0].endswith(": photo_2.png")
    for number in (0, 1):
        (root / images / f"photo_{number}.png").unlink()
    assert [photo.path for photo in load_collection(root).photos] == [root / images / "photo_3.png"]


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_truncated_photos_are_named_and_the_others_used(tmp_path, suffix):
    root = SmallScene(names=[f"{index}.{suffix}" for index in range(3)]).write(tmp_path / "scene")
    path = root / "images" / f"1.{suffix}"
    path.write_bytes(path.read_bytes()[:-30])
    collection = load_collection(root)
    assert len(collection.photos) == 2
    assert notes_with(collection, "unreadable")[0].count(f"1.{suffix} (ends before its picture does (truncated))") == 1


def test_photos_of_another_shape_than_their_camera_are_left_out(tmp_path):
    root = SmallScene().write(tmp_path / "scene")
    cv2.imwrite(str(root / "images" / "photo_3.png"), np.zeros((100, WIDTH, 3), np.uint8))
    collection = load_collection(root)
    assert len(collection.photos) == 3
    assert "photo_3.png (160x100, camera 160x120)" in notes_with(collection, "another shape")[0]


def test_sizes_rounded_to_whole_pixels_still_fit(tmp_path):
    root = SmallScene().write(tmp_path / "scene")
    cv2.imwrite(str(root / "images" / "photo_3.png"), np.zeros((41, 53, 3), np.uint8))  # a third of 160x120, rounded
    assert len(load_collection(root).photos) == 4


def test_mirrored_photos_are_left_out(tmp_path):
    root = SmallScene().write(tmp_path / "scene")
    add_exif(root / "images" / "photo_1.png", exif_block(2))
    collection = load_collection(root)
    assert len(collection.photos) == 3 and "photo_1.png" in notes_with(collection, "mirrored")[0]


def rewritten(tmp_path, change):
    """A scene whose model was changed by `change(reconstruction)`."""
    scene = SmallScene()
    root = scene.write(tmp_path / "scene")
    model = scene.reconstruction()
    change(model)
    model.write_binary(str(root / "sparse" / "0"))
    return root


@pytest.mark.parametrize("third, seventh", [([np.nan, 0, 0], [0, np.inf, 0]), ([1e300, -1e300, 0], [0, 1e9, 0])])
def test_points_that_are_not_finite_or_absurdly_far_are_dropped_and_counted(tmp_path, third, seventh):
    """1e300 is too large to be squared; with 1e9 the scene would be a dot in float32."""

    def spoil(model):
        model.points3D[3].xyz, model.points3D[7].xyz = np.array(third), np.array(seventh)

    collection = load_collection(rewritten(tmp_path, spoil))
    assert len(collection.points) == 18 and np.linalg.norm(collection.points, axis=1).max() < 10
    assert notes_with(collection, "2 points at NaN, infinite or absurd coordinates")
    scene = SmallScene()
    kept = np.delete(np.arange(20), [2, 6])  # ids begin at 1
    for index, photo in enumerate(collection.photos):
        pixels, _ = photo.camera.project(collection.points[photo.points])
        assert np.abs(pixels - scene.seen(index)[kept]).max() < 1e-6


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
@pytest.mark.parametrize("has_file", [True, False])
def test_a_model_without_points_keeps_its_poses(tmp_path, suffix, has_file):
    whole, scene = SmallScene(), SmallScene(points=np.empty((0, 3)))
    root = scene.write(tmp_path / "scene")
    model = root / "sparse" / "0"
    for path in model.iterdir():
        path.unlink()
    made = whole.reconstruction() if not has_file else scene.reconstruction()
    (made.write_binary if suffix == ".bin" else made.write_text)(str(model))
    if not has_file:
        (model / f"points3D{suffix}").unlink()
    collection = load_collection(root)
    assert collection.kind == "colmap" and collection.points.shape == (0, 3)
    for index, photo in enumerate(collection.photos):
        pixels, _ = photo.camera.in_world(collection.frame).project(whole.points)
        assert np.abs(pixels - whole.seen(index)).max() < 1e-6
    assert notes_with(collection, "No points are given with the cameras")
    lacking = "lacks the points that its photos see: copy it again if you have them"
    assert bool(notes_with(collection, lacking)) != has_file


def test_a_photo_that_sees_no_point_stays(tmp_path):
    def blind(model):
        for row in range(20):
            model.delete_observation(3, row)

    collection = load_collection(rewritten(tmp_path, blind))
    assert len(collection.photos[2].points) == 0
    assert "photo_2.png" in notes_with(collection, "without any SfM point")[0]


@pytest.mark.parametrize("params", [[3e6, 3e6, 80, 60], [1.0, 1.0, 80, 60]])
def test_extreme_focal_lengths_are_used_and_noted(tmp_path, params):
    collection = load_collection(SmallScene(params=params, points=np.array([[0.0, 0, 3]])).write(tmp_path / "scene"))
    assert len(collection.photos) == 4 and collection.photos[0].camera.fx == params[0]
    words = "4 photos of 4 with a focal length that no lens has, so expect a poor scene: photo_0.png ("
    (note,) = (note for note in collection.notes if note.text.startswith(words))
    assert not note.harmless


@pytest.mark.parametrize(
    "params", [[np.nan, 150, 80, 60], [150, -150, 80, 60], [150, 150, np.inf, 60], [0, 0, 80, 60], [1e50, 1e50, 80, 60]]
)
def test_broken_cameras_are_left_out(tmp_path, params):
    root = rewritten(tmp_path, lambda model: setattr(model.cameras[1], "params", params))
    with pytest.raises(BadInput, match="No photo of .* can be used: 4 photos with a camera or pose that is broken"):
        load_collection(root)


def test_panoramas_are_left_out(tmp_path):
    def widen(model):
        model.cameras[1].model = pycolmap.CameraModelId.EQUIRECTANGULAR
        model.cameras[1].params = [float(WIDTH), float(HEIGHT)]

    with pytest.raises(BadInput, match="panorama camera .*EQUIRECTANGULAR.*Correct .*sparse.*wegs sfm"):
        load_collection(rewritten(tmp_path, widen))


def test_a_model_without_any_of_its_photos_is_refused(tmp_path):
    root = SmallScene().write(tmp_path / "scene")
    for path in (root / "images").iterdir():
        path.unlink()
    words = "No photo of .*4 photos of the model missing .*photo_0.png.* Put the photos into"
    with pytest.raises(BadInput, match=words):
        load_collection(root)


def test_other_models_and_photos_without_a_pose_are_noted(tmp_path):
    scene = SmallScene()
    root = scene.write(tmp_path / "scene")
    (root / "sparse" / "1").mkdir()
    scene.reconstruction().write_binary(str(root / "sparse" / "1"))
    cv2.imwrite(str(root / "images" / "stranger.jpg"), np.zeros((9, 9, 3), np.uint8))
    collection = load_collection(root)
    assert notes_with(collection, "holds other models as well (1); 0 is used")
    (root / "sparse" / "0").rename(root / "sparse" / "10")  # that of few photos, say, was removed
    assert notes_with(load_collection(root), "holds other models as well (10); 1 is used")
    assert "stranger.jpg" in notes_with(collection, "without a pose")[0]
