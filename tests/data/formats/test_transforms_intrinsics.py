"""Intrinsics in a transforms.json, at the top or of a frame, with or without a size of the photos."""

import cv2
import numpy as np
import pytest

from core.data import load_collection
from tests.data.checks import notes_with
from tests.data.converted import changed, write_nerf_osr
from tests.data.small_scene import HEIGHT, WIDTH, SmallScene


def without_intrinsics(facts):
    for frame in facts["frames"]:
        for name in ("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_model"):
            del frame[name]


@pytest.mark.parametrize(
    ("top", "fx", "fy", "cx"),
    [
        ({"camera_angle_x": 2 * np.arctan(80 / 150)}, 150, 150, 80),
        ({"camera_angle_x": 2 * np.arctan(80 / 150), "camera_angle_y": 2 * np.arctan(60 / 120)}, 150, 120, 80),
        ({"fl_y": 140, "cx": 70}, 140, 140, 70),
        ({"fl_x": 150, "camera_angle_x": 0.1, "cx": None}, 150, 150, 80),  # Instant-NGP writes both
        ({"fl_x": 300, "fl_y": 300, "w": 320, "h": 240}, 150, 150, 80),  # photos half as large as said
    ],
)
def test_intrinsics_at_the_top(scene, top, fx, fy, cx):
    changed(scene, lambda facts: (without_intrinsics(facts), facts.update(top)))
    camera = load_collection(scene).photos[0].camera
    assert np.allclose([camera.fx, camera.fy, camera.cx, camera.cy], [fx, fy, cx, 60], rtol=1e-12)


def test_a_frames_own_intrinsics_come_first_and_photos_may_differ(scene):
    changed(
        scene, lambda facts: (without_intrinsics(facts), facts.update(fl_x=150), facts["frames"][2].update(fl_x=170))
    )
    assert [photo.camera.fx for photo in load_collection(scene).photos] == pytest.approx(
        [150, 150, 170, 150], rel=1e-12
    )


def test_a_frames_own_angle_comes_before_the_focal_length_of_all(scene):
    angle = 2 * np.arctan(80 / 170)
    changed(
        scene,
        lambda facts: (
            without_intrinsics(facts),
            facts.update(fl_x=150, fl_y=150),
            facts["frames"][2].update(camera_angle_x=angle),
        ),
    )
    cameras = [photo.camera for photo in load_collection(scene).photos]
    assert [(camera.fx, camera.fy) for camera in cameras[1:3]] == [
        pytest.approx((focal, focal), rel=1e-12) for focal in (150, 170)
    ]


def test_a_frames_own_focal_length_comes_before_the_angles_of_all(scene):
    angles = {"camera_angle_x": 0.5, "camera_angle_y": 0.5}
    changed(scene, lambda facts: (without_intrinsics(facts), facts.update(angles), facts["frames"][2].update(fl_x=170)))
    camera = load_collection(scene).photos[2].camera
    assert (camera.fx, camera.fy) == pytest.approx((170, 170), rel=1e-12)


def test_instant_ngps_fisheyes(scene):
    changed(scene, lambda facts: (without_intrinsics(facts), facts.update(fl_x=150, is_fisheye=True, k1=0.05, p1=0.1)))
    lens = load_collection(scene).photos[0].lens
    assert (lens.model, lens.params) == ("OPENCV_FISHEYE", [150, 150, 80, 60, 0.05, 0, 0, 0])


@pytest.mark.parametrize("model", [None, "", "opencv", "Pinhole"])
def test_camera_models_in_any_letters_and_none(scene, model):
    changed(scene, lambda facts: [frame.update(camera_model=model) for frame in facts["frames"]])
    assert len(load_collection(scene).photos) == 4


def halve(photos):
    for path in photos.glob("*.png"):
        assert cv2.imwrite(str(path), cv2.resize(cv2.imread(str(path)), (WIDTH // 2, HEIGHT // 2)))


def test_intrinsics_of_larger_photos_are_reported_if_no_size_is_stated(scene, tmp_path):
    """Focal lengths are wrong by the same factor, and nothing else shows it."""
    without_size = {"fl_x": 150, "fl_y": 150, "cx": WIDTH / 2, "cy": HEIGHT / 2}
    changed(scene, lambda facts: (without_intrinsics(facts), facts.update(without_size)))
    told = f"fit photos of about {WIDTH} x {HEIGHT} px (twice the principal point), the files have {WIDTH // 2} x {HEIGHT // 2}: expect a poor"
    assert not notes_with(load_collection(scene), "twice the principal point")
    halve(scene / "images")
    collection = load_collection(scene)
    assert notes_with(collection, told) and not next(note.harmless for note in collection.notes if told in note.text)
    changed(scene, lambda facts: facts.update(w=WIDTH, h=HEIGHT))
    assert not notes_with(load_collection(scene), "twice the principal point")


def test_shrunk_photos_of_nerf_osr_are_reported(tmp_path):
    splits = dict.fromkeys(SmallScene().names, "train")
    root = write_nerf_osr(SmallScene(model="SIMPLE_PINHOLE").write(tmp_path / "colmap"), tmp_path / "scene", splits)
    halve(root / "final" / "train" / "rgb")
    assert notes_with(load_collection(root), f"fit photos of about {WIDTH} x {HEIGHT} px")
