"""The COLMAP model beside a transforms.json: its points and tracks in the frame of the poses,
and the .ply where it does not fit."""

import shutil
import struct

import numpy as np
import pytest

from core.data import load_collection
from core.words import Note
from tests.data.checks import notes_with
from tests.data.converted import ELSEWHERE, changed, write_processed
from tests.data.formats.test_colmap_tracks import cut_features, cut_tracks
from tests.data.small_scene import SmallScene

NAMES = [f"photo_{number}.png" for number in range(5)]
MODEL = "colmap/sparse/0"


@pytest.fixture
def colmap(tmp_path):
    """A COLMAP scene of five photos, the second of which sees but half of the points."""
    root = SmallScene(names=NAMES).write(tmp_path / "colmap")
    model = SmallScene(names=NAMES).reconstruction()
    for number in range(1, 11):
        model.delete_observation(2, model.points3D[number].track.elements[1].point2D_idx)
    model.write_binary(str(root / "sparse" / "0"))
    return root


@pytest.fixture
def scene(colmap, tmp_path):
    return write_processed(colmap, tmp_path / "scene")


def frames(scene, change):
    """The scene, each of whose frames went through `change` with its number."""
    return changed(scene, lambda facts: [change(number, frame) for number, frame in enumerate(facts["frames"])])


def check_same(found, given):
    """That photos of the same names show the same points at the same pixels, and that no note asks for anything."""
    assert np.allclose(
        found.frame.to_world(found.points), ELSEWHERE * given.frame.to_world(given.points), rtol=0, atol=1e-9
    )
    assert np.array_equal(found.point_colours, given.point_colours)
    for ours, theirs in zip(found.photos, given.photos, strict=True):
        assert np.array_equal(ours.points, theirs.points)
        for one, other in zip(
            ours.camera.project(found.points[ours.points]),
            theirs.camera.project(given.points[theirs.points]),
            strict=True,
        ):
            assert np.allclose(one, other, rtol=0, atol=1e-6)
    assert Note(f"The points of the COLMAP model {found.root / MODEL} are used.", harmless=True) in found.notes
    assert not notes_with(found, "Nothing says which photo sees which point") and not notes_with(found, "not used")


@pytest.mark.parametrize("known_by", ["id", "name", "name without suffix"])
def test_points_and_tracks_are_those_of_the_model(scene, colmap, known_by):
    if known_by != "id":
        frames(scene, lambda number, frame: frame.pop("colmap_im_id"))
    if known_by == "name without suffix":
        frames(scene, lambda number, frame: frame.update(file_path=frame["file_path"].removesuffix(".png")))
    given = load_collection(colmap)
    assert [len(photo.points) for photo in given.photos] == [20, 10, 20, 20, 20]
    check_same(load_collection(scene), given)


def test_photos_that_were_renamed_are_known_by_their_ids(scene, colmap):
    for number, name in enumerate(NAMES):
        (scene / "images" / name).rename(scene / "images" / f"frame_0000{5 - number}.png")
    frames(scene, lambda number, frame: frame.update(file_path=f"./images/frame_0000{5 - number}.png"))
    found = load_collection(scene)
    assert [len(photo.points) for photo in found.photos] == [20, 20, 20, 10, 20]
    assert all(photo.camera.shows(found.points[photo.points])[0].all() for photo in found.photos)


def test_rounded_poses_fit(scene, colmap):
    frames(scene, lambda number, frame: frame.update(transform_matrix=np.round(frame["transform_matrix"], 4).tolist()))
    found, given = load_collection(scene), load_collection(colmap)
    assert all(
        np.array_equal(ours.points, theirs.points) for ours, theirs in zip(found.photos, given.photos, strict=True)
    )
    assert np.allclose(
        found.frame.to_world(found.points), ELSEWHERE * given.frame.to_world(given.points), rtol=0, atol=1e-2
    )


def test_a_photo_that_the_model_lacks_keeps_its_pose_and_sees_nothing(scene, colmap):
    SmallScene(names=NAMES[:4]).reconstruction().write_binary(str(scene / MODEL))
    found, whole = load_collection(scene), load_collection(write_processed(colmap, scene.parent / "whole"))
    assert [len(photo.points) for photo in found.photos] == [20, 20, 20, 20, 0]
    assert np.allclose(found.photos[4].camera.centre, whole.photos[4].camera.centre, rtol=0, atol=1e-9)
    assert notes_with(found, "1 photo without any SfM point: photo_4.png")


def test_of_several_models_the_largest_that_fits_is_used(scene, colmap):
    shutil.copytree(scene / MODEL, scene / "colmap/sparse/2")
    SmallScene(names=NAMES[:3]).reconstruction().write_binary(str(scene / MODEL))
    assert notes_with(load_collection(scene), "sparse/2 are used")
    (scene / "colmap/sparse/1").mkdir()
    SmallScene(names=[f"other_{number}.png" for number in range(9)]).reconstruction().write_binary(
        str(scene / "colmap/sparse/1")
    )
    found = load_collection(frames(scene, lambda number, frame: frame.pop("colmap_im_id")))
    assert notes_with(found, "sparse/2 are used") and not notes_with(found, "not used")


def test_a_model_without_tracks_says_so(scene):
    cut_features(scene / MODEL / "images.bin")
    cut_tracks(scene / MODEL / "points3D.bin")
    found = load_collection(scene)
    assert (
        len(found.points) == 20
        and notes_with(found, "are used")
        and notes_with(found, "Nothing says which photo sees which point")
    )


# --- what does not fit


def moved(shift):
    """The second camera moved along the line of all."""

    def change(number, frame):
        frame["transform_matrix"][0][3] += shift * (number == 1)

    return lambda scene: frames(scene, change)


def turned(axis, radians):
    """The second camera turned where it stands."""
    turn = np.eye(4)
    rows = [row for row in range(3) if row != axis]
    turn[np.ix_(rows, rows)] = [[np.cos(radians), -np.sin(radians)], [np.sin(radians), np.cos(radians)]]

    def change(number, frame):
        if number == 1:
            frame["transform_matrix"] = (np.array(frame["transform_matrix"]) @ turn).tolist()

    return lambda scene: frames(scene, change)


def mirrored(scene):
    """Another reconstruction: the cameras in opposite order on their line."""
    matrices = []
    frames(scene, lambda number, frame: matrices.append(frame["transform_matrix"]))
    frames(scene, lambda number, frame: frame.update(transform_matrix=matrices[4 - number]))


def truncated(name):
    def cut(scene):
        path = scene / MODEL / name
        path.write_bytes(path.read_bytes()[:-5])

    return cut


def broken_pose(scene):
    for name in ("rigs.bin", "frames.bin"):  # which earlier versions of COLMAP do not write
        (scene / MODEL / name).unlink()
    path = scene / MODEL / "images.bin"
    data = bytearray(path.read_bytes())
    data[12:20] = struct.pack("<d", np.nan)  # after the number of images and the first one's id
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (broken_pose, "its photos or poses are not those of the scene"),
        (moved(0.05), "its photos or poses are not those of the scene"),
        (turned(0, 0.05), "its photos or poses are not those of the scene"),
        (mirrored, "its photos or poses are not those of the scene"),
        (lambda scene: SmallScene(names=NAMES[:2]).reconstruction().write_binary(str(scene / MODEL)), "not those of the scene"),
        (lambda scene: frames(scene, lambda number, frame: frame.update(colmap_im_id=1)), "not those of the scene"),
        (truncated("points3D.bin"), "points3D.bin is truncated or damaged"),
        (truncated("images.bin"), "images.bin is truncated or damaged"),
        (lambda scene: (scene / MODEL / "images.bin").unlink(), "lacks images.bin"),
        (lambda scene: (scene / MODEL / "points3D.bin").unlink(), "it has no usable points"),
    ],
)  # fmt: skip
def test_the_points_file_is_used_where_the_model_does_not_fit(scene, spoil, why):
    spoil(scene)
    found = load_collection(scene)
    assert (len(found.photos), len(found.points)) == (5, 20) and not any(len(photo.points) for photo in found.photos)
    (note,) = (
        note
        for note in found.notes
        if note.text.startswith(f"The points of the COLMAP model {scene / MODEL} are not used: ")
    )
    assert why in note.text and not note.harmless
    assert notes_with(found, "Nothing says which photo sees which point")
    (scene / "sparse_pc.ply").unlink()
    changed(scene, lambda facts: facts.pop("ply_file_path"))
    assert notes_with(load_collection(scene), "`wegs train` triangulates them")


def test_a_camera_may_be_turned_by_less_than_a_hundredth(scene):
    """In radians; the rotation that brings all cameras together takes a fifth of it."""
    turned(0, 0.012)(scene)
    assert notes_with(load_collection(scene), "are used")


def test_one_photo_fits_no_frame(tmp_path):
    found = load_collection(write_processed(SmallScene(names=NAMES[:1]).write(tmp_path / "colmap"), tmp_path / "scene"))
    assert notes_with(found, "are not used") and len(found.points) == 20


@pytest.mark.parametrize("number", [None, "3", [3], 99, -1, 2.5])
def test_ids_that_are_none_of_the_model_are_passed_over(scene, number, colmap):
    frames(scene, lambda _, frame: frame.update(colmap_im_id=number))
    check_same(load_collection(scene), load_collection(colmap))
