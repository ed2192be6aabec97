"""Cameras of few photos: mapped again where their focal lengths run away."""

import shutil

import numpy as np
import pycolmap
import pytest

from core.data import mapping
from core.data.sfm import placed_of, reconstruct, shortfall
from tests.data.small_scene import SmallScene
from tests.heard import Heard
from tests.real_data import real

# Of the Statue of Liberty, from nearly one side. On its own COLMAP's mapping places 3 of them.
FROM_ONE_SIDE = (
    "video3_0052", "video2_0019", "video2_0017", "video4_0029", "video2_0018", "video2_0015", "video2_0022", "annie-spratt-JSvSIKCd9j4-unsplash",
)  # fmt: skip


def model(count: int, focal_px: float, odd: int = 0):
    """So many photos of a small scene, 160 px wide, and a focal length that explains them; 9,000 px explain `odd` of them."""
    made = pycolmap.Reconstruction()
    for index in range(count):
        length = 9e3 if index < odd else focal_px
        scene = SmallScene(params=[length, length, 80, 60])
        camera = scene.lens()
        camera.camera_id = index + 1
        made.add_camera_with_trivial_rig(camera)
        image = pycolmap.Image(name=f"{index}.jpg", keypoints=scene.seen(index), camera_id=index + 1, image_id=index + 1)
        made.add_image_with_trivial_frame(image, scene.pose(index))
    for row, point in enumerate(scene.points):
        track = pycolmap.Track()
        for index in range(count):
            track.add_element(index + 1, row)
        made.add_point3D(point, track, np.zeros(3, np.uint8))
    return made


@pytest.fixture
def mapped(monkeypatch):
    """Called with the models that mapping finds, first those with focal lengths refined, then last: what is taken of 8 photos, and what is said."""

    def choose(first, second):
        asked = []

        def models(work, names, report, refined):
            asked.append(refined)
            return first if refined else second

        monkeypatch.setattr(mapping, "_models", models)
        heard = Heard()
        return mapping.map_photos(None, [f"{index}.jpg" for index in range(8)], heard), heard.lines, asked

    return choose


@pytest.mark.parametrize("count, focal_px", [(3, 150.0), (6, 9e3), (6, 3.0), (0, 0.0)])
def test_most_photos_lost_are_mapped_again_with_focal_lengths_refined_last(mapped, count, focal_px):
    again = model(5, 150.0)
    taken, lines, _ = mapped([model(count, focal_px)] if count else [], [again])
    assert taken is again
    (line,) = lines
    plausible = 3 if count == 3 else 0
    assert line.startswith("Mapped again with focal lengths refined last: 5 of 8 photos got a place") and f"not {plausible} as with" in line


def test_focal_lengths_are_refined_in_the_end(mapped):
    again = model(5, 150.0)
    for camera in again.cameras.values():
        camera.focal_length_x = camera.focal_length_y = 140.0
    taken, _, _ = mapped([model(2, 150.0)], [again])
    assert taken.compute_mean_reprojection_error() < 0.1 and taken.cameras[1].focal_length_x != 140.0


@pytest.mark.parametrize("second", [[], [model(3, 150.0)], [model(6, 150.0, odd=1)]])
def test_what_is_not_better_is_not_taken(mapped, second):
    first = model(3, 150.0)
    taken, lines, asked = mapped([first], second)
    assert taken is first and lines == [] and asked == [True, False]


def test_half_the_photos_are_enough(mapped):
    first = model(4, 150.0)
    assert mapped([first], [model(8, 150.0)]) == (first, [], [True])


def test_real_photos_from_one_side(tmp_path):
    photos = tmp_path / "photos"
    photos.mkdir()
    for name in FROM_ONE_SIDE:
        shutil.copy(real("statue_of_liberty") / "dense" / "images" / f"{name}.jpg", photos)
    heard = Heard()
    scene = reconstruct(photos, tmp_path / "scene", heard)
    assert any(line.startswith("Mapped again with focal lengths refined last") for line in heard.lines)
    total, placed, plausible = placed_of(scene)
    assert total == 8 and placed == plausible >= 5 and not shortfall(scene)
