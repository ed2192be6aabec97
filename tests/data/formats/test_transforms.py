"""transforms.json and Blender's files: their cameras are those of the COLMAP model, and a line says what is wrong."""

import os
import re
import shutil

import cv2
import numpy as np
import pycolmap
import pytest

from core.data import load_collection
from core.data.photos.distortion import colmap_camera
from core.data.photos.pixels import load_photo
from core.errors import BadInput
from tests.data.checks import notes_with
from tests.data.converted import LENS_TERMS, changed, images_of, write_json, write_nerf_osr, write_nerfstudio
from tests.data.small_scene import HEIGHT, WIDTH, SmallScene
from tests.paths import PLAZA

EXACT_PX = 1e-6  # through text and back float64 loses far less


def lens_of(photo):
    """The photo's lens as a COLMAP camera, its own pinhole where it is not distorted."""
    camera = photo.camera
    if photo.lens is None:
        return pycolmap.Camera(model="PINHOLE", width=camera.width, height=camera.height, params=[camera.fx, camera.fy, camera.cx, camera.cy])  # fmt: skip
    return colmap_camera(photo.lens)


def farthest_px(first, second, points):
    """By how much two collections differ in where their photos of one name show points
    (world units), distorted or not."""
    worst, others = 0.0, {photo.name: photo for photo in second.photos}
    for photo in first.photos:
        seen = []
        for one, collection in ((photo, first), (others[photo.name], second)):
            camera = one.camera.in_world(collection.frame)
            local = (points - camera.centre) @ camera.world_to_camera.T
            seen.append(lens_of(one).img_from_cam(local[local[:, 2] > 0.1]))
        close = np.abs(seen[1]).max(axis=1) < 1e4  # px: what lies aside is seen by no photo
        worst = max(worst, np.abs(seen[0] - seen[1])[close].max())
    return worst


@pytest.mark.parametrize("model", LENS_TERMS)
def test_cameras_and_points_are_those_of_the_model(tmp_path, model):
    given = SmallScene(model=model)
    colmap = given.write(tmp_path / "colmap")
    found = load_collection(write_nerfstudio(colmap, tmp_path / "scene"))
    assert (found.name, found.kind, [photo.name for photo in found.photos]) == ("scene", "nerfstudio", given.names)
    assert farthest_px(found, load_collection(colmap), given.points) < EXACT_PX
    assert np.allclose(found.frame.to_world(found.points), given.points, rtol=0, atol=1e-12)
    assert [photo.split for photo in found.photos] == ["test", "train", "train", "train"]  # every eighth
    assert len(notes_with(found, "Nothing says which photo sees which point")) == 1
    assert not any(len(photo.points) for photo in found.photos)


def test_a_third_radial_term_is_taken_along(tmp_path):
    params = [150.0, 150.0, 80, 60, -0.1, 0.02, 0.003, 0.002, 0.01, 0, 0, 0]
    given = SmallScene(model="FULL_OPENCV", params=params)
    colmap = given.write(tmp_path / "colmap")
    root = tmp_path / "scene"
    shutil.copytree(colmap / "images", root / "images")
    frames = []
    for image in images_of(colmap)[0]:
        matrix = np.linalg.inv(np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])) * [1, -1, -1, 1]
        frames.append({"file_path": f"images/{image.name}", "transform_matrix": matrix.tolist()})
    terms = dict(zip(("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2", "k3"), params[:9], strict=True))
    write_json(root / "transforms.json", {**terms, "frames": frames})
    assert farthest_px(load_collection(root), load_collection(colmap), given.points) < EXACT_PX


def test_distortion_params_stand_for_the_terms(tmp_path):
    """As nerfstudio reads them: k1, k2, k3, k4, p1, p2."""
    given = SmallScene(model="OPENCV")
    colmap = given.write(tmp_path / "colmap")
    root = write_nerfstudio(colmap, tmp_path / "scene")

    def listed(facts):
        for frame in facts["frames"]:
            k1, k2, p1, p2 = (frame.pop(term) for term in ("k1", "k2", "p1", "p2"))
            frame["distortion_params"] = [k1, k2, 0, 0, p1, p2]

    assert farthest_px(load_collection(changed(root, listed)), load_collection(colmap), given.points) < EXACT_PX
    found = load_collection(changed(root, lambda facts: facts["frames"][1].update(distortion_params=[0.1, 0.2])))
    assert len(found.photos) == 3 and notes_with(found, "intrinsics that are not numbers")


def test_the_sample_has_the_same_cameras_in_every_format(tmp_path):
    given = load_collection(PLAZA)
    splits = {photo.name: photo.split for photo in given.photos}
    lists = {
        f"{split}_filenames": [f"images/{name}" for name in splits if splits[name] == split]
        for split in ("train", "test")
    }
    shown = given.frame.to_world(given.points)
    for root in (write_nerfstudio(PLAZA, tmp_path / "a", None, **lists), write_nerf_osr(PLAZA, tmp_path / "b", splits)):
        found = load_collection(root)
        assert {photo.name: photo.split for photo in found.photos} == splits
        assert farthest_px(found, given, shown) < EXACT_PX
        assert len(found.points) == 0 and notes_with(found, "`wegs train` triangulates them")


# --- where photos are


@pytest.mark.parametrize(
    "change", [str.upper, lambda name: name.removesuffix(".png"), lambda name: name.replace("/", "\\")]
)
def test_paths_without_a_suffix_and_of_windows(scene, change):
    if change is str.upper:
        (scene / "images").rename(scene / "IMAGES")
        for path in (scene / "IMAGES").iterdir():
            path.rename(path.with_name(path.name.upper()))
    changed(scene, lambda facts: [frame.update(file_path=change(frame["file_path"])) for frame in facts["frames"]])
    assert [photo.name.lower() for photo in load_collection(scene).photos] == SmallScene().names


def test_of_photos_that_were_shrunk_and_not_kept_the_small_ones_are_used(scene):
    before, folder, small = load_collection(scene).photos, scene / "images", scene / "images_2"
    small.mkdir()
    for path in sorted(folder.iterdir()):
        cv2.imwrite(
            str(small / path.name),
            cv2.resize(cv2.imread(str(path)), (WIDTH // 2, HEIGHT // 2), interpolation=cv2.INTER_AREA),
        )
        path.unlink()
    for whole, half in zip(before, load_collection(scene).photos, strict=True):
        assert (half.camera.width, half.camera.height) == (WIDTH // 2, HEIGHT // 2)
        assert half.camera.fx == pytest.approx(whole.camera.fx / 2) and half.camera.cy == pytest.approx(
            whole.camera.cy / 2
        )


def test_a_photo_that_was_taken_out_does_not_come_back_shrunken(scene):
    (scene / "images_2").mkdir()
    for path in (scene / "images").iterdir():
        (scene / "images_2" / path.name).write_bytes(path.read_bytes())
    (scene / "images" / "photo_1.png").unlink()
    assert [photo.name for photo in load_collection(scene).photos] == [
        name for name in SmallScene().names if name != "photo_1.png"
    ]


def test_photos_may_lie_outside_the_scene(scene, tmp_path):
    (scene / "images").rename(tmp_path / "elsewhere")
    paths = [str(tmp_path / "elsewhere" / "photo_0.png"), *(f"../elsewhere/photo_{number}.png" for number in (1, 2, 3))]
    changed(
        scene, lambda facts: [frame.update(file_path=path) for frame, path in zip(facts["frames"], paths, strict=True)]
    )
    (link := tmp_path / "colmap" / "link").symlink_to(scene)
    assert all([photo.name for photo in load_collection(root).photos] == SmallScene().names for root in (scene, link))


def test_names_that_are_not_utf_8_are_used_if_points_are_given_and_otherwise_reported(scene):
    latin = os.fsdecode(b"b\xe9.png")  # Python writes it as b\udce9.png
    (scene / "images" / "photo_1.png").rename(scene / "images" / latin)
    changed(scene, lambda facts: facts["frames"][1].update(file_path=f"images/{latin}"))
    assert latin in [photo.name for photo in load_collection(scene).photos]
    # COLMAP has to triangulate them.
    collection = load_collection(changed(scene, lambda facts: facts.pop("ply_file_path")))
    assert [photo.name for photo in collection.photos] == ["photo_0.png", "photo_2.png", "photo_3.png"]
    assert notes_with(collection, f"1 photo whose name is not in UTF-8, not used: {latin}")


# --- what is wrong


def spoil(field, value):
    return lambda frame: frame.update({field: value})


def turned(by):
    return lambda frame: frame.update(transform_matrix=(np.array(frame["transform_matrix"]) @ by).tolist())


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (lambda frame: frame.pop("file_path"), "1 photo without a file_path, not used: frame 1 of transforms.json"),
        (spoil("file_path", "images/gone.png"), "1 photo of transforms.json missing in .*images: gone.png"),
        (spoil("file_path", "images/" + "a" * 300), "missing in .*: aaaaaaaaaa"),
        (spoil("file_path", ""), "1 photo without a file_path"),
        (spoil("file_path", "images/photo_0.png"), "named more than once, used the first time: photo_0.png"),
        (lambda frame: frame.pop("transform_matrix"), "without a transform_matrix of 4 x 4 numbers, not used: photo_1.png"),
        (spoil("transform_matrix", [[1, 2], [3]]), "without a transform_matrix of 4 x 4 numbers"),
        (spoil("transform_matrix", [["a"] * 4] * 4), "without a transform_matrix of 4 x 4 numbers"),
        (spoil("transform_matrix", [[10**400] * 4] * 4), "without a transform_matrix of 4 x 4 numbers"),
        (turned(np.diag([1, 1, 1, np.nan])), "with numbers that are not finite, not used: photo_1.png"),
        (turned(np.diag([1, -1, 1, 1])), "that is mirrored, not used: photo_1.png"),
        (turned(np.diag([1, 1, 1.1, 1])), "that is not a rotation.*: photo_1.png"),
        (spoil("transform_matrix", np.zeros((4, 4)).tolist()), "that is not a rotation"),
        (spoil("camera_model", "FISHEYE624"), "camera_model that is not supported .FISHEYE624; OPENCV and OPENCV_FISHEYE are."),
        (spoil("camera_model", ["OPENCV"]), "camera_model that is not supported"),
        (spoil("fl_x", "wide"), "intrinsics that are not numbers, not used: photo_1.png"),
        (spoil("fl_x", 10**400), "intrinsics that are not numbers, not used: photo_1.png"),
        (spoil("fl_x", float("nan")), "camera or pose that is broken, not used: photo_1.png"),
        (spoil("fl_x", 0), "camera or pose that is broken"),
        (spoil("w", 0), "a w or h that no photo has"),
        (spoil("w", 300), "of another shape than the camera says, not used: photo_1.png .160x120, camera 300x120."),
        (spoil("k4", 0.1), "a k4, which only OPENCV_FISHEYE lenses have"),
        (lambda frame: (frame.pop("fl_x"), frame.pop("fl_y")), "without fl_x or camera_angle_x, not used"),
        (lambda frame: (frame.pop("fl_x"), frame.update(fl_y=None, camera_angle_x=0)), "camera or pose that is broken"),
    ],
)  # fmt: skip
def test_frames_that_are_wrong_are_named_and_the_others_used(scene, fault, words):
    collection = load_collection(changed(scene, lambda facts: fault(facts["frames"][1])))
    assert [photo.name for photo in collection.photos] == ["photo_0.png", "photo_2.png", "photo_3.png"]
    assert any(re.search(words, note.text) for note in collection.notes), collection.notes


def test_a_folder_in_place_of_a_photo_is_missing(scene):
    collection = load_collection(changed(scene, lambda facts: facts["frames"][1].update(file_path="/")))
    assert len(collection.photos) == 3 and notes_with(collection, "1 photo of transforms.json missing in ")


def test_a_file_without_a_usable_frame_is_refused(scene):
    changed(scene, lambda facts: [spoil("camera_model", "EQUIRECTANGULAR")(frame) for frame in facts["frames"]])
    with pytest.raises(
        BadInput, match="No photo of .*transforms.json can be used: 4 photos with a camera_model that is not supported"
    ):
        load_collection(scene)


def test_a_scaled_camera_sees_the_same_and_rounded_digits_are_made_whole(scene):
    plain = load_collection(scene)
    scaled = load_collection(changed(scene, lambda facts: turned(np.diag([2.0, 2.0, 2.0, 1.0]))(facts["frames"][1])))
    assert farthest_px(scaled, plain, SmallScene().points) < EXACT_PX
    changed(
        scene,
        lambda facts: facts["frames"][2].update(
            transform_matrix=np.round(facts["frames"][2]["transform_matrix"], 3).tolist()
        ),
    )
    rounded = load_collection(scene)
    matrix = rounded.photos[2].camera.world_to_camera
    assert np.allclose(matrix @ matrix.T, np.eye(3), rtol=0, atol=1e-12)
    # Half of the last digit is 5e-4 of an axis: 150 px of focal length show it as 0.1 px.
    assert farthest_px(rounded, plain, SmallScene().points) < 0.2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "transforms.json is not valid JSON: .*line 1"),
        ("", "is not valid JSON"),
        ("\xff\xfe", "is not valid JSON"),
        ("[" * 100_000, "is not valid JSON: it is nested too deeply"),
        ("[]", "has no list of frames"),
        ('{"frames": {}}', "has no list of frames"),
        ('{"frames": []}', "has no frames"),
        ('{"frames": [3]}', "without a file_path, not used: frame 0 of transforms.json"),
    ],
)
def test_broken_files_are_refused(scene, text, words):
    (scene / "transforms.json").write_text(text, encoding="latin-1")
    with pytest.raises(BadInput, match=words):
        load_collection(scene)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_files_as_windows_programs_save_them(scene, encoding):
    path = scene / "transforms.json"
    path.write_text(path.read_text(), encoding=encoding)
    assert len(load_collection(scene).photos) == 4


def test_a_folder_in_place_of_the_file_is_refused(scene):
    (scene / "transforms.json").unlink()
    (scene / "transforms.json").mkdir()
    with pytest.raises(BadInput, match="transforms.json cannot be read: Is a directory"):
        load_collection(scene)


# --- points and masks


def test_points_that_are_missing_or_in_another_frame_are_reported(scene, tmp_path):
    far = SmallScene(offset=np.array([900.0, 0.0, 0.0])).write(tmp_path / "far")
    assert not notes_with(load_collection(write_nerfstudio(far, tmp_path / "far-scene")), "of the points of")
    turn = np.diag([1, -1, -1, 1])  # of the world: all points lie behind the cameras then

    def turn_cameras(facts):
        for frame in facts["frames"]:
            frame["transform_matrix"] = (turn @ frame["transform_matrix"]).tolist()

    changed(scene, turn_cameras)
    assert notes_with(load_collection(scene), "Only 0% of the points of")
    (scene / "sparse_pc.ply").unlink()
    collection = load_collection(scene)
    assert notes_with(collection, "sparse_pc.ply is missing") and len(collection.points) == 0


def test_masks_hide_parts_of_training_photos_only(scene):
    (scene / "masks").mkdir()
    for number in range(3):
        mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
        mask[:, : WIDTH // 2] = 0
        assert cv2.imwrite(str(scene / "masks" / f"{number}.png"), mask)
    changed(
        scene,
        lambda facts: [frame.update(mask_path=f"masks/{number}.png") for number, frame in enumerate(facts["frames"])],
    )
    collection = load_collection(scene)
    assert [photo.mask and photo.mask.path.name for photo in collection.split("train")] == ["1.png", "2.png", None]
    assert [photo.mask for photo in collection.split("test")] == [None] and collection.undivided().split("train")[
        0
    ].mask.path.name == "0.png"
    assert notes_with(collection, "2 photos with a mask from") and notes_with(
        collection, "whose mask is missing, used whole: photo_3.png ("
    )
    assert not load_photo(collection.photos[1], WIDTH, HEIGHT).valid[:, : WIDTH // 2].any()
    undivided = load_collection(scene, all_photos=True)
    assert undivided.split("train")[0].mask.path.name == "0.png" and notes_with(undivided, "3 photos with a mask from")


def test_masks_of_instant_ngp_are_reported_as_not_used(scene):
    (scene / "images" / "dynamic_mask_photo_1.png").touch()
    found = load_collection(scene)
    assert notes_with(found, "1 photo whose dynamic_mask_*.png (Instant-NGP) is not used: invert it")
    assert all(photo.mask is None for photo in found.photos)


def test_file_names_that_are_no_text_are_reported(scene):
    changed(scene, lambda facts: (facts.update(ply_file_path=["x"]), facts["frames"][1].update(mask_path=7)))
    collection = load_collection(scene)
    assert notes_with(collection, "The ply_file_path ['x'] is no name of a file") and len(collection.points) == 0
    assert notes_with(collection, "with a mask_path that is no name, used whole: photo_1.png")


def test_other_files_of_frames_beside_a_transforms_json_are_named(scene):
    shutil.copy(scene / "transforms.json", scene / "transforms_test.json")
    assert notes_with(load_collection(scene), "holds transforms_test.json as well; transforms.json is used")
