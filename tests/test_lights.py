"""The pictures of looks are made from any run, and say how near a look comes to a truth that is known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from core.looks.find_look import find_look
from core.looks.trained import load_run
from core.report import QUIET
from samples import lights
from tests.failing import find_look_without_work
from tests.small import HEIGHT, WIDTH, finished, small_collection, small_settings


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run of seconds."""
    scene, folder = tmp_path_factory.mktemp("scene"), tmp_path_factory.mktemp("runs") / "small"
    collection = small_collection(scene)
    return finished(collection, small_settings(steps=4), folder).folder


def test_a_sheet_of_styles(folder, tmp_path, monkeypatch):
    reports = []

    def heard(*given, refine=True, report=QUIET):
        reports.extend([report] if refine else [])
        return find_look(*given, refine=refine, report=report)

    monkeypatch.setattr(lights, "find_look", heard)
    styles = []
    for name, colour in (("red", (0, 0, 200)), ("blue", (200, 0, 0))):
        styles.append(str(tmp_path / f"{name}.png"))
        cv2.imwrite(styles[-1], np.full((30, 40, 3), colour, np.uint8))
    sheet = tmp_path / "sheet.jpg"
    line = [str(folder), "--style", styles[0], "--style", styles[1], "--view", "photo_5.png", "-o", str(sheet)]
    told = CliRunner().invoke(lights.main, line, catch_exceptions=False)
    pixels = cv2.imread(str(sheet))
    assert told.output.endswith(f"{sheet}: {pixels.shape[1]}x{pixels.shape[0]} px\n")  # nobody knows the truth
    assert len(reports) == 3 and QUIET not in reports  # what takes seconds is heard of
    wide = round(lights.TILE_PX * WIDTH / HEIGHT)
    strip = 3 * wide // lights.FRAMES * HEIGHT // WIDTH
    assert pixels.shape == (2 * lights.TILE_PX + strip, 3 * wide, 3)  # photo, neutral, look; and what lies between
    middle = lights.TILE_PX // 2
    assert (np.abs(pixels[[middle, 3 * middle], wide // 2].astype(int) - ((0, 0, 200), (200, 0, 0))) < 8).all()  # JPEG
    # The strip begins with the first look and ends with the last.
    live = load_run(folder)
    photo = live.collection.photo("photo_5.png")
    frame = lights.rendered(live, find_look(live, styles[1]), photo)
    shown = lights.sheet(live, find_look(live, "neutral"), {style: find_look(live, style) for style in styles}, photo)[
        -1
    ]
    np.testing.assert_array_equal(shown[-1], lights.tile(frame, strip))


def test_a_grid_of_looks_with_their_photos(folder, tmp_path, few_steps):
    line = [str(folder), "--grid", "-o", str(sheet := tmp_path / "grid.jpg")]
    refused = CliRunner().invoke(lights.main, line)
    assert refused.exit_code == 1 and "Add --style PHOTO" in refused.output
    CliRunner().invoke(lights.main, [*line, "--style", "neutral", "--style", "photo_0.png"], catch_exceptions=False)
    wide = round(lights.LARGE_PX * WIDTH / HEIGHT)
    assert cv2.imread(str(sheet)).shape == (lights.LARGE_PX, 2 * wide, 3)
    live = load_run(folder)
    looks = dict.fromkeys(("neutral", "photo_1.png", "photo_2.png", "photo_3.png"), find_look(live, "neutral"))
    assert [len(row) for row in lights.grid_of(looks, live, live.collection.photo("photo_0.png"))] == [3, 1]


def test_a_sheet_without_photos(folder, tmp_path):
    """A row of looks for each view; nothing in it is a photo."""
    style, sheet = tmp_path / "green.png", tmp_path / "sheet.jpg"
    cv2.imwrite(str(style), np.full((30, 40, 3), (0, 255, 0), np.uint8))
    line = [
        str(folder),
        "--style",
        str(style),
        "--renders",
        "--view",
        "photo_5.png",
        "--view",
        "photo_1.png",
        "-o",
        str(sheet),
    ]
    CliRunner().invoke(lights.main, line, catch_exceptions=False)
    pixels, wide = cv2.imread(str(sheet)).astype(int), round(lights.TILE_PX * WIDTH / HEIGHT)
    assert pixels.shape == (2 * lights.TILE_PX, 2 * wide, 3)
    live = load_run(folder)
    for row, view in enumerate(("photo_5.png", "photo_1.png")):
        for column, word in enumerate(("neutral", str(style))):
            frame = lights.rendered(live, find_look(live, word), live.collection.photo(view))
            drawn = pixels[row * lights.TILE_PX :, column * wide :][: lights.TILE_PX, :wide]
            assert abs(drawn[..., ::-1] - lights.tile(frame, lights.TILE_PX)).mean() < 4  # JPEG


@pytest.mark.parametrize(
    "options, words",
    [
        (["-o", "x.png"], "not named like a JPEG"),
        (["--style", "photo_1.png", "--view", "photo_5.png", "--view", "photo_1.png"], "Without --renders one --view"),
        (["-o", "x.jpg"], "of samples/plaza"),
        (["--style", "photo_1.png", "-o", "x.jpg"], "add --renders"),
        (["--style", "photo_1.png", "--style", "bogus", "--renders", "-o", "x.jpg"], "bogus is neither a photo file"),
    ],
)
def test_what_cannot_be_drawn_is_refused_before_the_work(folder, options, words, monkeypatch):
    monkeypatch.setattr(lights, "find_look", find_look_without_work)
    result = CliRunner().invoke(lights.main, [str(folder), *options])
    assert result.exit_code == 1 and words in result.output


def test_a_sheet_is_replaced_only_with_force_and_a_missing_folder_is_noticed_before_the_work(
    folder, tmp_path, monkeypatch
):
    monkeypatch.setattr(lights, "find_look", None)
    (tmp_path / "sheet.jpg").write_bytes(b"old")
    for place, words in (("sheet.jpg", "sheet.jpg exists. Add --force"), ("gone/sheet.jpg", "There is no folder")):
        result = CliRunner().invoke(lights.main, [str(folder), "--style", "photo_1.png", "-o", str(tmp_path / place)])
        assert result.exit_code == 1 and words in result.output


def test_the_truth_is_found_in_the_scene_even_if_its_points_are_kept_elsewhere(folder, tmp_path):
    live = load_run(folder)
    known = live.collection.root / "truth" / "styles" / "dawn" / "photo_2.png"
    known.parent.mkdir(parents=True)
    known.write_bytes((live.collection.root / "photo_2.png").read_bytes())
    style = tmp_path / "dawn.jpg"
    for path in (style, live.collection.root / "styles" / style.name):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"the photo of dawn")
    live = replace(live, collection=replace(live.collection, points_from=tmp_path))
    assert live.collection.read_from == tmp_path and lights.truths(live, str(style)) == {"photo_2.png": known}
    style.write_bytes(b"another dawn, elsewhere")
    assert lights.truths(live, str(style)) == {}


def test_a_look_is_compared_with_its_known_truth(folder, few_steps):
    live = load_run(folder)
    root = live.collection.root
    style = root / "styles" / "own.png"
    known = root / "truth" / "styles" / "own"
    for path in (style.parent, known):
        path.mkdir(parents=True, exist_ok=True)
    style.write_bytes((root / "photo_2.png").read_bytes())  # a held-out photo, its own truth
    (known / "photo_2.png").write_bytes(style.read_bytes())
    look = find_look(live, str(style))
    words = lights.nearness(live, str(style), look)
    assert words.startswith("own.png: ") and "; the nearest of 4 looks of training photos" in words
    marks = "own.png: ", "in 1 view, zero-shot ", "fitted to the truth "
    own, read, fitted = (float(words.split(mark)[1].split()[0].rstrip(";")) for mark in marks)
    assert own == read and fitted >= own - 0.1  # too small to be located; fitted by L1, told in dB
    assert (
        len(lights.sheet(live, find_look(live, "neutral"), {str(style): look}, live.collection.photo("photo_2.png"))[0])
        == 4
    )  # the truth beside it
