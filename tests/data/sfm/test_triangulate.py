"""Points from known cameras: on the walls that were photographed, seen by the photos that show them,
and kept for the next run."""

import json
import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pycolmap
import pytest

from core.data import load_collection
from core.data.photos.pixels import load_photo
from core.data.prepare import prepared, scene_of_photos
from core.data.sfm import kept_points
from core.data.sfm.features import DATABASE
from core.data.sfm.triangulate import NEAREST, SPREAD, partners, sampson_distance_px, triangulate
from core.doctor import examine
from core.errors import BadInput
from core.looks.trained import TrainedRun
from core.report import Report
from core.run import run_config, run_folders
from core.scene.camera import Camera
from tests.data.converted import changed, write_json
from tests.data.room_corner import FOCAL, HEIGHT, WIDTH, write_corner
from tests.failing import failing
from tests.heard import Heard
from tests.small import small_settings


@pytest.fixture(scope="module")
def corner(tmp_path_factory):
    """A nerfstudio scene of the room corner without points; photo 0 is held out, photo 5 has its lower half masked."""
    return write_corner(tmp_path_factory.mktemp("corner"), masked=5)


@pytest.fixture(scope="module")
def kept(corner, tmp_path_factory):
    """The folder of its points, and what was said."""
    heard, before = Heard(), sorted(corner.iterdir())
    folder = prepared(corner, tmp_path_factory.mktemp("runs") / "corner-scene", heard).read_from
    assert sorted(corner.iterdir()) == before  # which may be read-only
    return folder, heard


def copy_of(kept, tmp_path):
    folder = tmp_path / "corner-scene"
    shutil.copytree(kept[0], folder)
    return folder


def test_points_lie_on_the_walls_and_photos_see_them(corner, kept):
    collection = load_collection(kept[0])
    assert (collection.name, collection.kind, collection.read_from) == (corner.name, "nerfstudio", kept[0])
    points = collection.frame.to_world(collection.points)
    off = np.abs(points - [-1, 1, 5])  # of the planes x = -1, y = 1 and z = 5
    # 0.01 was seen in 1277 points: 0.3 px of 380 at a distance of 5, from about a unit apart.
    assert len(points) > 500 and np.median(off.min(axis=1)) < 0.02
    assert np.ptp(collection.point_colours) > 0.3
    assert len(collection.photo("0.png").points) == 0  # held out: points are of training photos
    for photo in collection.split("train"):
        pixels, depth = photo.camera.project(collection.points[photo.points])
        assert len(photo.points) > 20 and (depth > 0).all()
        # COLMAP drops what is reprojected farther off than 4 px, so near the border points may be a little outside.
        assert (pixels > -5).all() and (pixels < (WIDTH + 5, HEIGHT + 5)).all()
    hidden = collection.photo("5.png")
    assert (hidden.camera.project(collection.points[hidden.points])[0][:, 1] < HEIGHT / 2 + 5).all()
    assert load_photo(hidden, WIDTH, HEIGHT).valid[HEIGHT // 2 + 1 :].sum() == 0


def two_photos(scene):
    """Photos 1 and 2, each with its camera in the world."""
    collection = load_collection(scene)
    return [
        (photo, photo.camera.in_world(collection.frame))
        for photo in (collection.photo("1.png"), collection.photo("2.png"))
    ]


def test_matches_farther_than_two_pixels_off_their_lines_are_left_out(corner, tmp_path):
    photos = two_photos(corner)
    triangulate(photos, tmp_path, Report())
    with pycolmap.Database.open(tmp_path / DATABASE) as database:
        numbers = [database.read_image_with_name(f"{number:06d}.jpg").image_id for number in (1, 2)]
        pixels = [database.read_keypoints(number)[:, :2].astype(np.float64) for number in numbers]
        found, kept = database.read_matches(*numbers), database.read_two_view_geometry(*numbers).inlier_matches
    off_px = sampson_distance_px(
        *(camera for _, camera in photos), *(places[rows] for places, rows in zip(pixels, found.T, strict=True))
    )
    assert (off_px > 2).any() and np.array_equal(kept, found[off_px <= 2])


def test_cameras_that_few_matches_agree_with_are_reported(corner, kept, tmp_path):
    assert not any("matches between photos" in line for line in kept[1].lines)

    def turn(facts):
        # Each 40 degrees further about the direction in which it looks.
        for number, frame in enumerate(facts["frames"]):
            cosine, sine = np.cos(np.radians(40 * number)), np.sin(np.radians(40 * number))
            about = np.array([[cosine, -sine, 0, 0], [sine, cosine, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
            frame["transform_matrix"] = (frame["transform_matrix"] @ about).tolist()

    scene = changed(shutil.copytree(corner, tmp_path / "other"), turn)
    for _ in range(2):  # the second time, of points that are used again
        heard = Heard()
        prepared(scene, tmp_path / "scene", heard)
        assert any(
            re.match("! Only .*% of the matches between photos agree with the cameras.*Check that its poses", line)
            for line in heard.lines
        )
    assert any("Points as triangulated before" in line for line in heard.lines)


def test_few_points_that_two_photos_see_count(corner, tmp_path, monkeypatch):
    def ten_nearest(*given):
        off_px = sampson_distance_px(*given)
        off_px[np.argsort(off_px)[10:]] = np.inf
        return off_px

    monkeypatch.setattr("core.data.sfm.triangulate.sampson_distance_px", ten_nearest)
    model, _ = triangulate(two_photos(corner), tmp_path, Report())
    assert 1 <= model.num_points3D() <= 10


def test_no_features_are_looked_for_where_a_mask_hides_the_photo(tmp_path):
    """A board of holes: what fills them has corners."""
    scene, work = tmp_path / "scene", tmp_path / "work"
    for folder in (scene, work):
        folder.mkdir()
    write_corner(scene, masked=1)
    use = np.kron(np.indices((HEIGHT // 10, WIDTH // 10)).sum(axis=0) % 2, np.ones((10, 10))) > 0
    assert cv2.imwrite(str(scene / "mask.png"), use * np.uint8(255))
    triangulate(two_photos(scene), work, Report())
    with pycolmap.Database.open(work / DATABASE) as database:
        masked = database.read_image_with_name("000001.jpg").image_id
        columns, rows = database.read_keypoints(masked)[:, :2].astype(int).T
    assert len(rows) > 100 and use[rows, columns].all()


def test_points_are_triangulated_once_for_the_same_photos_and_cameras(corner, kept, tmp_path):
    folder, heard = kept
    assert any("has cameras but no points: they are triangulated from 5 photos" in line for line in heard.lines)
    assert any(line.startswith(f"{folder}: ") and line.endswith(" points") for line in heard.lines)
    again = Heard()
    assert prepared(corner, folder, again).read_from == folder
    assert again.lines == [f"Points as triangulated before in {folder}; remove it to have them found again."]
    assert prepared(folder, tmp_path / "other", again).read_from == folder  # lacks nothing
    first, second = load_collection(folder), load_collection(folder)
    assert first.changed_since(second) == [] and (first.points == second.points).all()


def test_other_cameras_and_lenses_get_points_of_their_own(corner, tmp_path):
    scene = tmp_path / "scene"
    shutil.copytree(corner, scene)
    facts = json.loads((scene / "transforms.json").read_text())
    made = []
    for change in ({}, {"fl_x": FOCAL * 1.01}, {"k1": 0.01}, {}):
        write_json(scene / "transforms.json", facts | change)
        made.append(prepared(scene, tmp_path / "points", Report()).read_from.name)
    assert made == ["points", "points-2", "points-3", "points"]


def test_a_copy_of_a_scene_gets_points_of_its_own(corner, kept, tmp_path):
    """Those of the scene itself would be lost with it."""
    wanted, copy = copy_of(kept, tmp_path), shutil.copytree(corner, tmp_path / "copy")
    assert prepared(corner, wanted, Report()).read_from == wanted
    assert prepared(copy, wanted, Report()).read_from.name == "corner-scene-2"


def test_a_scene_that_is_gone_or_a_damaged_model_is_refused(kept, tmp_path):
    folder = copy_of(kept, tmp_path)
    (folder / "points" / "points3D.bin").write_bytes(b"")
    with pytest.raises(BadInput, match="points3D.bin is truncated or damaged"):
        load_collection(folder)
    facts = json.loads((folder / "triangulated.json").read_text())
    write_json(folder / "triangulated.json", facts | {"scene": str(tmp_path / "nowhere"), "from_here": "../nowhere"})
    with pytest.raises(BadInput, match="holds the points of .*nowhere, which is gone. Move it back"):
        load_collection(folder)


def test_scene_points_and_run_may_be_moved_together(corner, tmp_path):
    before = tmp_path / "project"
    shutil.copytree(corner, before / "photos")
    collection = prepared(before / "photos", before / "runs" / "photos-scene", Report())
    run_folders.create(before / "runs" / "photos", collection, small_settings())
    now = before.rename(tmp_path / "elsewhere")
    points, run_folder = now / "runs" / "photos-scene", now / "runs" / "photos"
    again = prepared(now / "photos", points, Report())
    assert again.read_from == points and not (now / "runs" / "photos-scene-2").exists()
    for found in (again, run_config.read_config(run_folder).collection):
        assert found.read_from == points and found.changed_since(collection) == []
        assert all(photo.path.is_relative_to(now / "photos") and photo.path.is_file() for photo in found.photos)
    (now / "photos").rename(tmp_path / "other")  # alone
    with pytest.raises(
        BadInput,
        match="holds the points of .*project.photos, which is gone. Move it back, or write where it is now into .*triangulated.json, as its scene",
    ):
        load_collection(points)
    trained = SimpleNamespace(collection=run_config.read_config(run_folder).collection, folder=run_folder)
    with pytest.raises(
        BadInput, match="cannot be read: the scene .*project.photos is gone. .*triangulated.json, as its scene"
    ):
        TrainedRun.sized_photo(trained, trained.collection.photos[0])
    write_json(
        points / "triangulated.json",
        json.loads((points / "triangulated.json").read_text()) | {"scene": str(tmp_path / "other")},
    )
    assert load_collection(points).changed_since(collection) == []


def test_cameras_that_fit_no_photo_are_refused(corner, tmp_path):
    def stack(facts):
        facts["frames"] = facts["frames"][:3]
        for number, frame in enumerate(facts["frames"]):  # each a unit above the last
            frame["transform_matrix"] = [[1, 0, 0, 0], [0, 1, 0, number], [0, 0, 1, 0], [0, 0, 0, 1]]

    no_points(corner, tmp_path, stack, "No point could be triangulated.*poses are in the axes of its format")


def test_one_photo_is_too_few(corner, tmp_path):
    words = "1 photo to train on can be read; at least 2"
    no_points(corner, tmp_path, lambda facts: facts.update(frames=facts["frames"][:1]), words)


def no_points(corner, tmp_path, change, words):
    """Of the scene whose transforms.json went through `change` no points are made, and `words` say why."""
    other = shutil.copytree(corner, tmp_path / "other")
    with pytest.raises(BadInput, match=words):
        prepared(changed(other, change), tmp_path / "scene", Report())
    assert not (tmp_path / "scene").exists()


@pytest.mark.parametrize(
    "split", ["", "filename\tid\tsplit\n1.png\t1\ttest\n" + "".join(f"{n}.png\t{n}\ttrain\n" for n in range(2, 6))]
)
def test_a_colmap_model_without_points_gets_them(corner, kept, tmp_path, split):
    scene, heard = tmp_path / "scene", Heard()
    shutil.copytree(corner, scene / "images")
    shutil.copytree(kept[0] / "points", scene / "sparse")
    (scene / "sparse" / "points3D.bin").unlink()
    if split:
        (scene / "corner.tsv").write_text(split)
    collection = prepared(scene, tmp_path / "scene-scene", heard)
    assert (collection.kind, collection.read_from) == ("colmap", tmp_path / "scene-scene")
    off = np.abs(collection.frame.to_world(collection.points) - [-1, 1, 5]).min(axis=1)
    assert len(off) > 500 and np.median(off) < 0.02
    assert [photo.name for photo in collection.split("test")] == ["1.png"]
    assert prepared(scene, tmp_path / "scene-scene", heard).read_from == collection.read_from
    found = {finding.name: finding for finding in examine(scene, heard)} | {
        finding.name: finding for finding in examine(collection.read_from, heard)
    }
    assert found["points"].figure.startswith(f"{len(off):,},") and "photos with few points" not in found


def test_masks_of_the_user_hide_points_and_are_refused_before_any_are_made(corner, tmp_path, monkeypatch):
    masks, hidden = tmp_path / "masks", np.zeros((HEIGHT, WIDTH), np.uint8)
    masks.mkdir()
    cv2.imwrite(str(masks / "elsewhere.png"), hidden)
    with monkeypatch.context() as patch, pytest.raises(BadInput, match="holds no mask of a training photo"):
        patch.setattr(kept_points, "triangulate", failing(AssertionError()))
        prepared(corner, tmp_path / "scene", Report(), masks=masks)
    hidden[:, : WIDTH // 2] = 255
    cv2.imwrite(str(masks / "2.png"), hidden)
    collection = prepared(corner, tmp_path / "scene", Report(), masks=masks)
    seen = {photo.name: photo.camera.project(collection.points[photo.points])[0] for photo in collection.split("train")}
    assert (seen["2.png"][:, 0] < WIDTH / 2 + 5).all() and (seen["1.png"][:, 0] > WIDTH / 2 + 5).any()
    assert (seen["5.png"][:, 1] > HEIGHT / 2 + 5).any()  # whose own mask no longer counts


def test_kept_points_that_were_deleted_are_reported(kept, tmp_path):
    folder = copy_of(kept, tmp_path)
    (folder / "points" / "points3D.bin").unlink()
    with pytest.raises(
        BadInput, match="points holds no points any more. Remove .*corner-scene to have them found again"
    ):
        load_collection(folder)


def test_a_damaged_and_an_empty_photo_do_no_harm(corner, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(corner, other)
    noise = np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    data = cv2.imencode(".jpg", noise)[1].tobytes()
    (other / "4.png").write_bytes(data[: len(data) // 2] + b"\xff\xd9")  # seen only once it is decoded
    assert cv2.imwrite(str(other / "3.png"), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    collection = prepared(other, tmp_path / "scene", Report())
    assert [len(photo.points) > 0 for photo in collection.photos] == [False, True, True, False, False, True]


def test_plain_photos_beside_a_description_are_pointed_to_it(corner, tmp_path, monkeypatch):
    monkeypatch.setattr("core.data.prepare.reconstruct", lambda photos, output, report: output.mkdir())
    (tmp_path / "images").mkdir()
    shutil.copy(corner / "1.png", tmp_path / "images")
    shutil.copy(corner / "transforms.json", tmp_path)
    heard = Heard()
    scene_of_photos(tmp_path / "images", tmp_path / "found", heard)
    assert heard.lines == [
        f"! {tmp_path} is a nerfstudio scene: give that folder to use its cameras. Now they are found anew."
    ]


# --- the parts


def looking(centre, degrees):
    """A camera at `centre`, turned by `degrees` about the y axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return Camera(np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]), np.array(centre, float), 100, 120, 50, 40, 100, 80)


def test_partners_are_all_of_few_and_linear_in_many():
    few = [looking((x, 0, 0), 5 * x) for x in range(6)]
    assert partners(few) == sorted((a, b) for a in range(6) for b in range(a))
    assert partners([looking((0, 0, 0), 0), looking((1, 0, 0), 180)]) == []  # back to back
    many = partners([looking((x, 0, 0), 0) for x in range(300)])
    assert len(many) <= 300 * (NEAREST + SPREAD)
    assert {(x + 1, x) for x in range(299)} <= set(many) and (299, 0) in many


def test_the_distance_from_the_epipolar_line_is_that_in_pixels():
    """A sideways camera sees epipolar lines as rows:
    a match d rows off misses by d / sqrt(2), shared by both pictures."""
    first, second = looking((0, 0, 0), 0), looking((1, 0, 0), 0)
    points = np.array([[0.5, 0.2, 5], [-1, -1, 8.0]])
    a, b = (camera.project(points)[0] for camera in (first, second))
    assert sampson_distance_px(first, second, a, b).max() < 1e-9  # float64
    assert sampson_distance_px(first, second, a, b + [3, 4]) == pytest.approx([4 / np.sqrt(2)] * 2, rel=1e-9)
    turned = looking((1, 0.3, -0.2), 20)
    assert sampson_distance_px(first, turned, a, turned.project(points)[0]).max() < 1e-9
    assert np.isfinite(
        sampson_distance_px(first, replace(first, centre=first.centre), a, b)
    ).all()  # one place: no line
