"""A scene on the table: a sound one is sound, what is wrong is named."""

import json
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pycolmap
import pytest

from core import pipeline
from core.data.prepare import prepared
from core.data.sfm import originals
from core.doctor import Finding, examine
from core.doctor import scene as module
from core.doctor.finding import verdict
from core.system.atomic import write_json
from tests.data.converted import changed, write_blender, write_nerfstudio
from tests.data.small_scene import HEIGHT, WIDTH, SmallScene
from tests.doctor.examined import asked_for, examined
from tests.heard import Heard


def test_a_sound_scene(tmp_path):
    random = np.random.default_rng(0)
    points = random.uniform((-1, -0.7, 3), (1, 0.7, 3.5), (600, 3))
    findings, heard = examined(SmallScene(model="SIMPLE_PINHOLE", points=points).write(tmp_path / "scene"))
    assert asked_for(findings) == set()
    assert findings["points"].figure.startswith("600, 600 a photo")
    assert "float32 without recentring would cost" in findings["world"].meaning
    assert heard.lines[-1].endswith("nothing to do.")


def test_points_without_tracks_are_not_counted_by_photo(tmp_path):
    scene = write_nerfstudio(SmallScene(model="SIMPLE_PINHOLE").write(tmp_path / "colmap"), tmp_path / "scene")
    points = examined(scene)[0]["points"]
    assert points.figure.startswith("20, the farthest ") and "a photo" not in points.figure
    assert points.advice == "Give more of them, or run SfM with more features."
    assert examined(tmp_path / "colmap")[0]["points"].advice == "Add photos, or run SfM with more features."


def test_a_bad_mask_is_not_blamed_on_its_photo_and_ignored_if_that_is_held_out(tmp_path):
    scene = write_nerfstudio(SmallScene(model="SIMPLE_PINHOLE").write(tmp_path / "colmap"), tmp_path / "scene")
    for number in range(2):  # 0 is held out
        cv2.imwrite(str(scene / f"{number}.png"), np.zeros((HEIGHT, WIDTH), np.uint8))
        changed(scene, lambda facts, number=number: facts["frames"][number].update(mask_path=f"{number}.png"))
    found = examined(scene)[0]["unusable photos"]
    assert found.figure.startswith("1 of 4 (photo_1.png (is left with 0.0% of its pixels by its mask)")
    assert found.meaning == "cannot be used; training leaves them out"
    assert found.advice == "White (255) marks what is to be used, black what is not."


def test_files_that_are_meant_to_be_left_out_ask_for_nothing(tmp_path):
    scene = write_blender(SmallScene(model="SIMPLE_PINHOLE").write(tmp_path / "colmap"), tmp_path / "scene")
    (scene / "transforms_val.json").write_bytes((scene / "transforms_test.json").read_bytes())
    noted = [finding for finding in examine(scene, Heard()) if "transforms_val.json is not used" in finding.figure]
    assert [finding.advice for finding in noted] == [""]


def test_notes_are_judged_by_who_wrote_them_not_by_their_words(tmp_path):
    names = [f"photo_{index}.png" for index in range(4)]
    scene = SmallScene(names=[*names, "used all the same.png"]).write(tmp_path / "scene")
    (scene / "images" / "used all the same.png").unlink()
    noted = {finding.figure: finding.advice for finding in examine(scene, Heard()) if finding.name == "reading"}
    assert [bool(advice) for figure, advice in noted.items() if "missing in" in figure] == [True]
    assert [bool(advice) for figure, advice in noted.items() if "every 8th" in figure] == [False]


def test_what_the_reader_notes_asks_for_a_look(tmp_path):
    scene = SmallScene(model="SIMPLE_PINHOLE").write(tmp_path / "scene")
    (scene / "test.txt").write_text("bogus.png\n")
    asking = [finding.figure for finding in examine(scene, Heard()) if finding.name == "reading" and finding.advice]
    assert len(asking) == 2 and asking[0] == "1 photo of test.txt not in the model: bogus.png"
    assert asking[1].startswith("test.txt holds out none of these photos")


def stray_scene(root, off=900.0):
    """Nine photos, of which five are wrong in their own way, far from the origin. off: of photo 5's camera."""
    scene = SmallScene(names=[f"photo_{index}.png" for index in range(9)], offset=np.array([5e6, 0.0, 0.0]))
    made = scene.reconstruction()
    scene.write(root)
    for name, level in (("photo_1.png", 0), ("photo_2.png", 255)):
        cv2.imwrite(str(root / "images" / name), np.full((HEIGHT, WIDTH, 3), level, np.uint8))
    damaged = root / "images" / "photo_3.png"
    data = bytearray(damaged.read_bytes())
    data[60:90] = bytes(30)  # seen only when it is decoded
    damaged.write_bytes(bytes(data))
    (root / "images" / "photo_4.png").unlink()
    pose, centre = scene.pose(5), scene.offset + [off, 0.0, 0.0]
    made.images[6].frame.rig_from_world = type(pose)(pose.rotation, -pose.rotation.matrix() @ centre)
    made.write_binary(str(root / "sparse/0"))
    return root


def test_the_verdict_names_each_thing_once():
    findings = [Finding("reading", "one", "said", "Correct it."), Finding("reading", "two", "said", "Correct it.")]
    assert verdict(findings) == "Verdict: 2 of 2 checks need attention: reading."


def test_a_scene_with_faults_names_them(tmp_path):
    findings, heard = examined(stray_scene(tmp_path / "scene"))
    assert findings["photos of one colour"].figure == "2 of 8 (photo_1.png: 0 of 255, photo_2.png: 255 of 255)"
    assert findings["unusable photos"].figure.startswith("1 of 8 (photo_3.png (")
    assert findings["cameras astray"].figure == "1 of 8 (photo_5.png)"
    assert findings["cameras that look away"].figure == "1 of 8 (photo_5.png)"
    assert "files are written around the scene" in findings["world"].meaning
    assert any("missing" in line and line.startswith("! !! reading") for line in heard.lines)  # photo_4
    assert findings["points"].advice  # twenty
    assert {"photos of one colour", "unusable photos", "cameras astray", "points"} <= asked_for(findings)


def test_a_model_that_contradicts_its_own_points_is_reported(tmp_path):
    findings, heard = examined(turned_about(tmp_path / "most", 3))
    assert findings["cameras that look away"].figure.startswith("3 of 4 (photo_0.png,")
    assert findings["cameras that look away"].advice.startswith("Check that its poses are in the axes of its format")
    told = "reading: 3 of 4 cameras see less than 50% of the points said to be theirs: expect a poor scene"
    assert any(line.startswith(f"! !! {told}") for line in heard.lines)
    findings, heard = examined(turned_about(tmp_path / "half", 2))
    assert findings["cameras that look away"].figure.startswith("2 of 4") and "expect a poor scene" not in " ".join(
        heard.lines
    )
    assert findings["cameras that look away"].advice.startswith("Remove them")


def turned_about(root, count):
    """A scene in which so many cameras look the other way."""
    scene = SmallScene()
    model = scene.reconstruction()
    for number in range(1, count + 1):
        frame = model.frames[model.images[number].frame_id]
        frame.rig_from_world = (
            pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.0, np.pi, 0.0])), np.zeros(3)) * frame.rig_from_world
        )
    model.write_binary(str(scene.write(root) / "sparse" / "0"))
    return root


# The others are about 3 from the points.
@pytest.mark.parametrize(("off", "figure"), [(25.0, "none"), (40.0, "1 of 8 (photo_5.png)")])
def test_how_far_a_camera_may_be(tmp_path, off, figure):
    assert examined(stray_scene(tmp_path / "scene", off))[0]["cameras astray"].figure == figure


@pytest.mark.parametrize(
    "params, name, figure",
    [
        ([3e6, 3e6, 80, 60], "odd focal lengths", "4 of 4 (photo_0.png: 1.88e+04,"),
        ([150, 190, 80, 60], "unequal focal lengths", "4 of 4"),
        ([150, 150, 54, 60], "principal points", "4 of 4"),
        ([150, 150, 58, 60], "principal points", "none"),
    ],
)
def test_cameras_out_of_the_ordinary(tmp_path, params, name, figure):
    findings, _ = examined(replace(SmallScene(), params=params).write(tmp_path / "scene"))
    assert findings[name].figure.startswith(figure) and bool(findings[name].advice) == (figure != "none")


def test_a_camera_out_of_the_ordinary_is_named_with_advice_and_not_said_to_be_used_all_the_same(tmp_path):
    _, heard = examined(stray_scene(tmp_path / "far"))
    assert [line.split(":")[0] for line in heard.lines if "as far off as" in line] == ["! !! cameras astray"]
    _, heard = examined(replace(SmallScene(), params=[3e6, 3e6, 80, 60]).write(tmp_path / "narrow"))
    named = [line.split(":")[0] for line in heard.lines if "focal length" in line and "photo_0.png" in line]
    assert named == ["! !! odd focal lengths"]


def test_photos_without_points_or_cameras(tmp_path):
    scene = SmallScene(points=np.array([[0.0, 0.0, 3.0]]))
    findings, _ = examined(scene.write(tmp_path / "scene"))
    assert findings["photos with few points"].figure.startswith("4 of 4 (photo_0.png: 1,")
    (tmp_path / "scene" / "images" / "photo_1.png").write_bytes(b"no photo")
    findings, _ = examined(tmp_path / "scene" / "images")
    assert findings["scene"].meaning == f"photos within the colmap scene {tmp_path / 'scene'}"
    assert findings["scene"].advice == "Give that folder to use its cameras, if it names these photos."
    assert findings["unusable photos"].figure.startswith("1 of 4 (photo_1.png (is not")
    assert findings["photos in other formats"].advice == ""
    (tmp_path / "scene" / "images" / "IMG_1.DNG").write_bytes(b"x")
    other = examined(tmp_path / "scene" / "images")[0]["photos in other formats"]
    assert other.figure == "1 of 5 (IMG_1.DNG)" and "JPEG" in other.advice
    (tmp_path / "scene" / "images" / "a.jpg").symlink_to(tmp_path / "gone.jpg")
    unusable = examined(tmp_path / "scene" / "images")[0]["unusable photos"]
    assert (
        unusable.figure.startswith("2 of 5 (a.jpg (is a link to a file that is gone), ")
        and "Connect its disk" in unusable.advice
    )


@pytest.mark.parametrize(("photos", "needed"), [(1, True), (3, False)])
def test_points_to_be_triangulated_need_two_photos(tmp_path, photos, needed):
    frames = [{"file_path": f"{number}.png", "transform_matrix": np.eye(4).tolist()} for number in range(photos)]
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": 150, "w": WIDTH, "h": HEIGHT, "frames": frames}))
    save_photos(tmp_path, photos)
    points = examined(tmp_path)[0]["points"]
    assert points.figure == "none" and bool(points.advice) == needed


def save_photos(folder, count):
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(count):
        cells = np.random.default_rng(number).integers(0, 256, (HEIGHT // 10, WIDTH // 10, 3), np.uint8)
        picture = cv2.resize(cells, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
        assert cv2.imwrite(str(folder / f"{number}.png"), picture)


@pytest.mark.parametrize(
    "count, words", [(2, "1 pair to match, up to 1 minute"), (24, "276 pairs to match, up to 1 minute")]
)
def test_sound_photos_are_sound_and_the_next_step_is_named(tmp_path, count, words):
    save_photos(tmp_path, count)
    findings, heard = examined(tmp_path)
    assert findings["scene"].figure == f"{count} photos of 0.019 MP"
    assert (
        findings["scene"].meaning
        == f"photos without cameras; next, `wegs train {tmp_path}` finds them ({words}) and trains"
    )
    assert heard.lines[-1] == f"{tmp_path}: Verdict: sound; 5 checks, nothing to do."


@pytest.mark.parametrize(
    "seconds, words", [(61, "2 minutes"), (7200, "120 minutes"), (7201, "3 hours"), (23_624, "7 hours")]
)
def test_the_time_for_many_photos_is_given_in_hours(tmp_path, monkeypatch, seconds, words):
    save_photos(tmp_path, 2)
    monkeypatch.setattr(module, "longest_s", lambda photos: seconds)
    assert f"(1 pair to match, up to {words})" in examined(tmp_path)[0]["scene"].meaning


@pytest.mark.parametrize(
    "red, spread, is_flat", [(100, 0, True), (100, 4, True), (100, 8, True), (100, 16, False), (140, 0, False)]
)
def test_a_photo_is_flat_if_its_numbers_hardly_differ(red, spread, is_flat):
    pixels = np.random.default_rng(0).integers(100, 101 + spread, (90, 60, 3)).astype(np.uint8)
    pixels[..., 0] += np.uint8(red - 100)
    assert module.is_flat(pixels) == is_flat == (pixels.std() < module.FLAT)


def test_pictures_stored_twice_are_reported_and_matched_once(tmp_path):
    save_photos(tmp_path, 3)
    assert cv2.imwrite(str(tmp_path / "again.jpg"), cv2.imread(str(tmp_path / "0.png")), [cv2.IMWRITE_JPEG_QUALITY, 90])
    findings, _ = examined(tmp_path)
    twice = findings["pictures stored twice"]
    assert twice.figure == "1 of 4 (again.jpg is the picture 0.png once more, with fewer bytes)" and not twice.advice
    assert "(3 pairs to match" in findings["scene"].meaning


def test_the_smallest_and_largest_photo_sizes_are_given(tmp_path, monkeypatch):
    save_photos(tmp_path, 2)
    assert cv2.imwrite(str(tmp_path / "1.png"), cv2.resize(cv2.imread(str(tmp_path / "1.png")), (320, 240)))
    assert examined(tmp_path)[0]["scene"].figure == "2 photos of 0.019 to 0.077 MP"
    large = SimpleNamespace(header=SimpleNamespace(width=12000, height=9000), pixels=np.zeros((1, 1, 3), np.uint8))
    monkeypatch.setattr(module, "usable_photos", lambda paths, report: [(path, large) for path in paths])
    assert examined(tmp_path)[0]["scene"].figure == "2 photos of 108 MP"


def test_photos_too_small_to_find_cameras_by_are_reported(tmp_path):
    save_photos(tmp_path, 3)
    assert cv2.imwrite(str(tmp_path / "1.png"), np.zeros((12, 16, 3), np.uint8))
    findings, _ = examined(tmp_path)
    unusable = findings["unusable photos"]
    assert (
        unusable.figure == "1 of 3 (1.png (is 16 x 12 px, too small to find features in))"
        and unusable.advice == "Use a larger photo."
    )
    assert "(1 pair to match" in findings["scene"].meaning
    (tmp_path / "0.png").write_bytes(b"")
    assert (
        examined(tmp_path)[0]["unusable photos"].advice
        == "Copy it again, or convert it to JPEG or PNG. Use a larger photo."
    )


def test_one_photo_is_too_few_to_find_cameras(tmp_path):
    save_photos(tmp_path, 1)
    assert examined(tmp_path)[0]["scene"].advice.startswith("Add photos of the same place: at least 2")


@pytest.mark.parametrize("place", ["old", "keyframes/images", "sensors/records_data/left"])
def test_photos_in_a_subfolder_that_is_not_searched_are_reported(tmp_path, place):
    save_photos(tmp_path, 2)
    for count, advice in ((2, ""), (3, "Give that folder, or put all photos into one.")):
        save_photos(tmp_path / place, count)
        found = examined(tmp_path)[0]["photos elsewhere"]
        assert found.figure == f"{count} in {tmp_path / place}, beside the 2 in {tmp_path}" and found.advice == advice


def test_photos_beside_the_folder_that_is_used_are_reported(tmp_path):
    save_photos(tmp_path, 2)
    save_photos(tmp_path / "images", 3)
    found = examined(tmp_path)[0]["photos elsewhere"]
    assert (
        found.figure == f"2 in {tmp_path}, beside the 3 in {tmp_path / 'images'}"
        and found.advice == "Put all photos into one."
    )


def test_a_model_in_an_unusual_folder_is_reported(tmp_path):
    found = examined(SmallScene().write(tmp_path, sparse="sfm"))[0]["cameras elsewhere"]
    assert (
        found.figure == f"{tmp_path / 'sfm'} holds a COLMAP model"
        and found.advice == f"Move it to {tmp_path / 'sparse' / '0'}."
    )


def test_the_scene_made_of_photos_of_which_some_are_gone_holds_no_photos_elsewhere(tmp_path):
    save_photos(tmp_path, 2)
    scene = tmp_path / "runs" / "photos-scene"
    save_photos(scene / "images", 3)
    (scene / "sparse").mkdir()
    write_json(scene / originals.MADE_OF, {})
    assert "photos elsewhere" not in examined(tmp_path)[0]


def mark_as_made(scene, placed, total, focal_px):
    """As if `placed` of `total` photos of 160 x 120 px had got a place."""
    lens = {"model": "SIMPLE_PINHOLE", "width": WIDTH, "height": HEIGHT, "params": [focal_px, WIDTH / 2, HEIGHT / 2]}
    write_json(scene / originals.MADE_OF, {})
    write_json(scene / originals.NAMES, {f"/photos/{number}.png": f"{number}.png" for number in range(total)})
    write_json(scene / originals.LENSES, {f"{number}.png": lens for number in range(placed)})


@pytest.mark.parametrize(
    "placed, focal_px, words",
    [
        (4, 150.0, "Only 4 of 9 photos could be placed: expect a poor scene. Add photos from in between."),
        (6, 4000.0, "Only 6 of 9 photos could be placed, and 6 of these with a focal length that no lens has: expect"),
        (5, 150.0, ""),
    ],
)
def test_a_scene_that_lost_most_of_its_photos_says_so(tmp_path, placed, focal_px, words, monkeypatch):
    scene = SmallScene().write(tmp_path / "scene")
    assert "photos placed" not in examined(scene)[0] and not originals.shortfall(scene)
    mark_as_made(scene, placed, 9, focal_px)
    assert originals.shortfall(scene).startswith(words) and bool(originals.shortfall(scene)) == bool(words)
    heard = Heard()
    prepared(scene, tmp_path / "made", heard)
    monkeypatch.setattr("core.pipeline.cameras.reconstruct", lambda photos, output, report, lists: output)
    save_photos(tmp_path / "photos", 2)
    pipeline.find_cameras(tmp_path / "photos", scene, heard)
    assert heard.lines == [f"! {originals.shortfall(scene)}"] * 2 * bool(words) + [f"Next: wegs train {scene}"]
    found = examined(scene)[0]["photos placed"]
    assert found.figure == f"{placed} of 9" and bool(found.advice) == bool(words)
