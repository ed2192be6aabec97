"""Cameras of few photos: they are mapped again if their focal lengths run away."""

import shutil

import cv2
import numpy as np
import pycolmap
import pytest

from core.data.sfm import mapping
from core.data.sfm.features import PHOTOS
from core.data.sfm.originals import MADE_OF, NAMES, placed_of, shortfall
from core.data.sfm.reconstruct import reconstruct, write_scene
from core.errors import BadInput
from core.system.atomic import write_json
from tests.data.small_scene import SmallScene
from tests.heard import Heard
from tests.real_data import real

# Of the Statue of Liberty. With focal lengths refined along the way COLMAP's mapping places 3 of them, and wrongly.
APART = (
    "25557973021_168924d6c3_o", "4062457156_97bd2c4e3f_o", "4062457816_ebf0a49963_o", "43227407690_b4eb5db8b1_o", "45194583384_53c1aef0f9_o",
    "5090396836_67bca7429c_o", "5090398104_47d3e1112a_o", "8151983731_066084233f_o", "dan-smedley-Y_u2dC2TSgI-unsplash",
    "video1_0020", "video1_0044", "video4_0024", "video4_0026",
)  # fmt: skip


def model(count: int, focal_px: float, points: int = 15):
    """So many photos of a small scene, 160 px wide, a focal length that explains them,
    and so many of the scene's 20 points."""
    made = pycolmap.Reconstruction()
    for index in range(count):
        scene = SmallScene(params=[focal_px, focal_px, 80, 60])
        camera = scene.lens()
        camera.camera_id = index + 1
        made.add_camera_with_trivial_rig(camera)
        image = pycolmap.Image(
            name=f"{index}.jpg", keypoints=scene.seen(index), camera_id=index + 1, image_id=index + 1
        )
        made.add_image_with_trivial_frame(image, scene.pose(index))
    for row, point in enumerate(scene.points[:points]):
        track = pycolmap.Track()
        for index in range(count):
            track.add_element(index + 1, row)
        made.add_point3D(point, track, np.zeros(3, np.uint8))
    return made


START = {f"{index}.jpg": 150 / 160 for index in range(3)}  # what model(3, 150.0) finds


@pytest.fixture
def mapped(monkeypatch):
    """Called with the models that mapping finds, first with focal lengths refined along the way, then last, from the
    guess and from those found: what is taken of 8 photos, what is said, and where each mapping began."""

    def choose(first, second, third=()):
        asked = []

        def models(work, names, report, start=None):
            asked.append(start)
            return first if start is None else third if start else second

        monkeypatch.setattr(mapping, "_models", models)
        heard = Heard()
        return mapping.map_photos(None, [f"{index}.jpg" for index in range(8)], heard), heard.lines, asked

    return choose


@pytest.mark.parametrize("count, focal_px", [(3, 150.0), (6, 9e3), (6, 3.0), (0, 0.0)])
def test_most_photos_lost_are_mapped_again_with_focal_lengths_refined_last(mapped, count, focal_px):
    again = model(5, 150.0, points=16)
    taken, lines, _ = mapped([model(count, focal_px)] if count else [], [again])
    assert taken is again
    (line,) = lines
    plausible = 3 if count == 3 else 0
    assert (
        line.startswith("Mapped again with focal lengths refined last: 5 of 8 photos got a place")
        and f"not {plausible} as with" in line
    )


def test_focal_lengths_are_refined_in_the_end(mapped):
    again = model(5, 150.0, points=16)
    for camera in again.cameras.values():
        camera.focal_length_x = camera.focal_length_y = 140.0
    taken, _, _ = mapped([model(2, 150.0)], [again])
    assert taken.compute_mean_reprojection_error() < 0.1 and taken.cameras[1].focal_length_x != 140.0


@pytest.mark.parametrize(
    "second", [[], [model(3, 150.0, points=20)], [model(6, 150.0, points=15)], [model(6, 9e3, points=20)]]
)
def test_what_is_not_better_is_not_taken(mapped, second):
    first = model(3, 150.0)
    taken, lines, asked = mapped([first], second)
    assert taken is first and lines == [] and asked == [None, {}, START]


def test_the_better_of_the_two_that_are_mapped_again_is_taken(mapped):
    guessed, begun = model(5, 150.0, points=16), model(6, 150.0, points=16)
    for second, third in ((guessed, begun), (begun, guessed)):
        taken, lines, asked = mapped([model(3, 150.0)], [second], [third])
        assert taken is begun and "last: 6 of 8 photos" in lines[0] and asked == [None, {}, START]


def test_what_was_found_is_what_mapping_begins_with(tmp_path):
    with pycolmap.Database.open(tmp_path / "database.db") as database:
        for number, (focal_px, known) in enumerate(((192, False), (192, False), (192, False), (300, True)), 1):
            lens = pycolmap.Camera(model="SIMPLE_RADIAL", width=160, height=120, params=[focal_px, 80, 60, 0])
            lens.has_prior_focal_length = known
            database.write_image(pycolmap.Image(name=f"{number}.jpg", camera_id=database.write_camera(lens)))
    mapping._begin_with(tmp_path / "database.db", {"1.jpg": 1.0, "2.jpg": 2.0, "4.jpg": 4.0})
    with pycolmap.Database.open(tmp_path / "database.db") as database:
        begun = {image.name: database.read_camera(image.camera_id).focal_length for image in database.read_all_images()}
    assert begun == {"1.jpg": 160, "2.jpg": 320, "3.jpg": 320, "4.jpg": 300}  # EXIF told that of the last


def test_photos_are_not_mapped_again_if_half_of_them_have_a_place(mapped):
    first = model(4, 150.0)
    assert mapped([first], [model(8, 150.0)]) == (first, [], [None])


def fold(found: pycolmap.Reconstruction, *numbers: int) -> None:
    """Give these cameras a lens formula that folds over inside their photos."""
    lens = pycolmap.Camera(model="SIMPLE_RADIAL", width=160, height=120, params=[100, 80, 60, -1.6])
    for number in numbers:
        found.cameras[number].model = lens.model
        found.cameras[number].params = lens.params


def test_photos_whose_lens_folds_over_are_dropped(mapped):
    found = model(6, 100)
    fold(found, 2, 5)
    chosen, lines, _ = mapped([found], [])
    assert {image.image_id for image in chosen.images.values() if image.has_pose} == {1, 3, 4, 6}
    assert lines == ["! 2 photos fit only with an impossible lens and were left out."]


@pytest.mark.parametrize(("folded", "apart"), [((1, 2, 3, 4, 5), "2 places (4, 1 photos)"), ((1, 2, 3, 4, 5, 6), None)])
def test_the_model_that_is_largest_without_them_is_kept(mapped, folded, apart):
    largest, other = model(6, 100), model(4, 100)
    fold(largest, *folded)
    chosen, lines, _ = mapped([largest, other], [])
    assert chosen is other
    assert lines == (
        [
            f"! The photos fall apart into {apart}; the largest is kept. Add photos that connect them, or give each place a folder."
        ]
        if apart
        else []
    )


def test_two_photos_of_many_are_no_scene(mapped):
    found = model(4, 100)
    fold(found, 2, 3)
    with pytest.raises(
        BadInput, match="Cameras could be found for only 2 of 8 photos: the 8 photos do not overlap enough. Add photos"
    ):
        mapped([found], [])


def test_photos_that_were_dropped_count_as_lost(tmp_path):
    found = model(6, 100)
    for number in (2, 3, 4, 5):
        found.deregister_frame(number)
    (tmp_path / PHOTOS).mkdir()
    for index in range(6):
        assert cv2.imwrite(str(tmp_path / PHOTOS / f"{index}.jpg"), np.full((120, 160, 3), 99, np.uint8))
    scene = tmp_path / "scene"
    write_scene(tmp_path, found, {f"{index}.jpg": f"photo {index}.jpg" for index in range(6)}, scene)
    write_json(scene / MADE_OF, {f"/{index}.jpg": [0, 0] for index in range(6)})
    write_json(scene / NAMES, {f"/{index}.jpg": f"photo {index}.jpg" for index in range(6)})
    assert placed_of(scene) == (6, 2, 2) and shortfall(scene).startswith("Only 2 of 6 photos could be placed")


def test_real_photos_that_are_lost_at_first(tmp_path):
    photos = tmp_path / "photos"
    photos.mkdir()
    for name in APART:
        shutil.copy(real("statue_of_liberty") / "dense" / "images" / f"{name}.jpg", photos)
    heard = Heard()
    scene = reconstruct(photos, tmp_path / "scene", heard)
    assert any(line.startswith("Mapped again with focal lengths refined last") for line in heard.lines)
    total, placed, plausible = placed_of(scene)
    assert total == 13 and placed == plausible >= 10 and not shortfall(scene)
