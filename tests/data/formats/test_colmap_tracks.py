"""COLMAP models in which points or photos do not say which photo sees which point,
as some programs and users leave them."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from core.data import load_collection
from core.data.formats.colmap import read_points
from core.doctor import examine
from core.errors import BadInput
from tests.data.checks import check_geometry, notes_with
from tests.data.small_scene import SmallScene
from tests.heard import Heard


def cut(path, keep):
    """Take all features out of an images.bin, or all tracks out of a points3D.bin;
    `keep` is where their number stands in the record."""
    data, start = path.read_bytes(), 8
    records = [data[:8]]
    while start < len(data):
        end, size = keep(data, start)
        records += data[start:end], bytes(8)
        start = end + 8 + size * int.from_bytes(data[end : end + 8], "little")
    path.write_bytes(b"".join(records))


def cut_features(path):
    cut(path, lambda data, start: (data.index(b"\0", start + 64) + 1, 24))


def cut_tracks(path):
    cut(path, lambda data, start: (start + 43, 8))


def test_points_without_tracks_are_seen_as_the_photos_say(tmp_path):
    root = SmallScene().write(tmp_path / "scene")
    cut_tracks(root / "sparse" / "0" / "points3D.bin")
    collection = load_collection(root)
    check_geometry(collection, SmallScene())
    assert notes_with(collection, "do not say which of its photos see them: its photos do")


@pytest.mark.parametrize("left_out", [1, 7, 20])
def test_observations_of_points_that_are_left_out_are_ignored(tmp_path, left_out):
    model = SmallScene().reconstruction()
    model.points3D[left_out].xyz = np.full(3, np.nan)
    for point in model.points3D.values():
        point.track = pycolmap.Track()
    points, notes = read_points(model, Path("model"))
    assert len(points.positions) == 19 and len(notes) == 2
    seen = [SmallScene().reconstruction().points3D[number].xyz for number in range(1, 21) if number != left_out]
    assert np.array_equal(points.positions, seen)
    assert [rows.tolist() for rows in points.seen.values()] == [list(range(19))] * 4


@pytest.mark.parametrize("tracks", [True, False])
def test_points_without_any_tracks_are_used_and_that_is_reported(tmp_path, tracks):
    root = SmallScene().write(tmp_path / "scene")
    cut_features(root / "sparse" / "0" / "images.bin")
    if not tracks:
        cut_tracks(root / "sparse" / "0" / "points3D.bin")
    collection = load_collection(root)
    assert (len(collection.photos), len(collection.points)) == (4, 20)
    assert notes_with(collection, "Nothing says which photo sees which point") and not notes_with(
        collection, "without any SfM point"
    )
    assert not any(finding.name == "photos with few points" for finding in examine(root, Heard()))


def in_text(root):
    """The folder of the scene's model, which is in text from now on, and the lines of its images.txt."""
    model = SmallScene().in_text(root)
    return model, (model / "images.txt").read_text().splitlines()


def test_photos_that_were_taken_out_of_a_text_model_by_hand(tmp_path):
    root = SmallScene().write(tmp_path / "scene")
    model, lines = in_text(root)
    first = next(number for number, line in enumerate(lines) if line.endswith("photo_0.png"))
    (model / "images.txt").write_text("\n".join(lines[:first] + lines[first + 2 :]) + "\n")
    collection = load_collection(root)
    assert {photo.name: len(photo.points) for photo in collection.photos} == {
        f"photo_{index}.png": 20 for index in (1, 2, 3)
    }
    assert notes_with(collection, "1 photo in") and notes_with(collection, "its photos do")


def test_photos_that_were_taken_out_of_a_binary_model_by_hand(tmp_path):
    root = SmallScene().write(tmp_path / "scene")
    images = root / "sparse" / "0" / "images.bin"
    data = images.read_bytes()
    end = data.index(b"photo_1.png") - 64
    images.write_bytes((3).to_bytes(8, "little") + data[end:])
    collection = load_collection(root)
    assert {photo.name: len(photo.points) for photo in collection.photos} == {
        f"photo_{index}.png": 20 for index in (1, 2, 3)
    }
    assert notes_with(collection, "1 photo in") and notes_with(collection, "its photos do")


def test_points_are_sorted_by_id_whatever_their_order_in_the_file(tmp_path):
    scene = SmallScene()
    root = scene.write(tmp_path / "scene")
    path, model = root / "sparse" / "0" / "points3D.bin", scene.reconstruction()
    for number in range(1, 21):
        for photo in range(1, number % 3 + 1):
            model.delete_observation(photo, number - 1)
    model.write_binary(str(path.parent))
    data, records, start = path.read_bytes(), [], 8
    while start < len(data):
        end = start + 51 + 8 * data[start + 43]
        records.append(data[start:end])
        start = end
    path.write_bytes(data[:8] + b"".join(sorted(records, reverse=True)))
    collection = load_collection(root)
    for index, photo in enumerate(collection.photos):
        assert np.abs(photo.camera.project(collection.points)[0] - scene.seen(index)).max() < 1e-6
    seen = [photo.points.tolist() for photo in collection.photos]
    assert seen == [[number - 1 for number in range(1, 21) if photo > number % 3] for photo in range(1, 5)]


def test_a_photo_that_sees_a_point_twice_sees_one_point():
    model = SmallScene().reconstruction()
    model.delete_point3D(2)
    model.add_observation(5, pycolmap.TrackElement(1, 1))
    points, _ = read_points(model, Path("model"))
    assert points.seen["photo_0.png"].tolist() == points.seen["photo_1.png"].tolist() == list(range(19))


def test_names_with_spaces_in_text(tmp_path):
    root = SmallScene().write(tmp_path / "scene")
    model, lines = in_text(root)
    (model / "images.txt").write_text("\n".join(line.replace("photo_", "a photo ") for line in lines) + "\n")
    for index in range(4):
        (root / "images" / f"photo_{index}.png").rename(root / "images" / f"a photo {index}.png")
    assert [photo.name for photo in load_collection(root).photos] == [f"a photo {index}.png" for index in range(4)]


@pytest.mark.parametrize(("column", "word"), [(1, "nan"), (1, "1e200"), (4, "inf"), (5, "-nan"), (7, "1e400")])
def test_a_pose_in_text_that_is_not_finite_is_left_out_alone(tmp_path, column, word):
    """pycolmap reads such a pose from a binary model, and would refuse the whole text."""
    root = SmallScene().write(tmp_path / "scene")
    model, lines = in_text(root)
    pose = next(number for number, line in enumerate(lines) if line.endswith("photo_1.png"))
    words = lines[pose].split()
    lines[pose] = " ".join([*words[:column], word, *words[column + 1 :]])
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    collection = load_collection(root)
    assert [photo.name for photo in collection.photos] == ["photo_0.png", "photo_2.png", "photo_3.png"]
    assert notes_with(collection, "1 photo with a camera or pose that is broken, not used: photo_1.png")
    assert all(len(photo.points) for photo in collection.photos)


@pytest.mark.parametrize("word", ["nan", "-nan(ind)", "Infinity", "1.5e+400"])
@pytest.mark.parametrize(("column", "left"), [(1, 19), (7, 20)])  # a coordinate, and an error, which nobody uses
def test_a_point_in_text_that_is_not_finite_is_left_out_alone(tmp_path, column, left, word):
    root = SmallScene().write(tmp_path / "scene")
    path = in_text(root)[0] / "points3D.txt"
    lines = path.read_text().splitlines()
    words = lines[-1].split()
    path.write_text("\n".join([*lines[:-1], " ".join([*words[:column], word, *words[column + 1 :]])]))
    collection = load_collection(root)
    assert len(collection.points) == left and [len(photo.points) for photo in collection.photos] == [left] * 4
    assert len(notes_with(collection, "1 point at NaN, infinite or absurd coordinates left out.")) == 20 - left


def test_a_camera_in_text_that_is_not_finite_costs_its_own_photos_alone(tmp_path):
    root = SmallScene().write(tmp_path / "scene")
    model, lines = in_text(root)
    (model / "images.txt").write_text("\n".join(lines).replace(" 1 photo_1.png", " 2 photo_1.png") + "\n")
    (model / "cameras.txt").write_text("1 PINHOLE 160 120 150 165 78 63\n2 PINHOLE 160 120 150 inf 78 nan\n")
    collection = load_collection(root)
    assert [photo.name for photo in collection.photos] == ["photo_0.png", "photo_2.png", "photo_3.png"]
    assert notes_with(collection, "1 photo with a camera or pose that is broken, not used: photo_1.png")
    assert [len(photo.points) for photo in collection.photos] == [20] * 3


@pytest.mark.parametrize(
    ("part", "words", "other"), [("images", " 1 photo_1.png", " nan photo_1.png"), ("cameras", " 160 ", " inf ")]
)
def test_nan_or_infinity_in_place_of_a_whole_number_is_refused(tmp_path, part, words, other):
    path = in_text(SmallScene().write(tmp_path / "scene"))[0] / f"{part}.txt"
    text = path.read_text()
    assert words in text
    path.write_text(text.replace(words, other))
    with pytest.raises(BadInput, match=f"{part}.txt line .* is '{other.split()[0]}', not a whole number"):
        load_collection(tmp_path / "scene")


def test_photos_of_one_line_in_text_are_refused_and_those_of_an_empty_second_line_read(tmp_path):
    """pycolmap would drop the last one without a word."""
    root = SmallScene().write(tmp_path / "scene")
    model, lines = in_text(root)
    photos = [line for line in lines if line.endswith(".png")]
    (model / "images.txt").write_text("\n\n".join(photos) + "\n\n")
    assert len(load_collection(root).photos) == 4
    alike = "\n".join(photos) + "\n"
    for text, name in [
        (alike, "photo_0.png"),
        (alike.replace(".png", ""), "photo_0"),
        ("\n\n".join(photos), "photo_3.png"),
    ]:
        (model / "images.txt").write_text(text)
        with pytest.raises(BadInput, match=f"images.txt gives {name} one line in place of two. Add the line"):
            load_collection(root)
