"""The picture sheet: where things stand and what the colours mean."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from core.data.photos.names import png_paths
from core.evaluation.protocols import ViewPictures
from core.evaluation.sheet import error_picture, picture_sheet, pictures_kept, row_of, titles, write_view
from core.export.labelled_sheet import GAP_PX, LABEL_PX
from core.export.pictures import TILE_PX


def row(height, width, mask=None, name="photo.jpg"):
    photo = np.full((height, width, 3), (200, 100, 50), np.uint8)
    return ViewPictures(name, photo, photo // 2, "refined", mask)


def sheet_of(*views):
    return picture_sheet([row_of(view, "") for view in views], "half", 9)


def test_columns_are_photo_render_mask_error():
    mask = np.zeros((5, 8), np.float32)
    mask[:, 4:] = 1
    sheet = sheet_of(row(40, 64, mask))
    step = 64 + GAP_PX
    assert sheet.shape == (LABEL_PX + 40 + GAP_PX + LABEL_PX, 4 * step, 3)
    middle = sheet[LABEL_PX + 20]
    assert middle[5].tolist() == [200, 100, 50] and middle[step + 5].tolist() == [100, 50, 25]
    assert middle[2 * step + 5].tolist() == [0, 0, 0] and middle[2 * step + 60].tolist() == [255] * 3
    photo = row(40, 64).photo
    assert middle[3 * step + 5].tolist() == error_picture(photo, photo // 2)[0, 0].tolist()


def test_photos_of_all_sizes_fit_and_keep_their_shape():
    sheet = sheet_of(row(600, 1000), row(50, 20), row(1, 1))
    assert sheet.shape[1] == 3 * (TILE_PX + GAP_PX)
    assert sheet.shape[0] == 4 * LABEL_PX + 3 * GAP_PX + round(600 * TILE_PX / 1000) + 50 + 1


def test_labels_are_written():
    with_name = picture_sheet([row_of(row(30, 90), "20.1 dB")], "half", 9)
    without = sheet_of(row(30, 90, name=""))
    assert (with_name[-LABEL_PX:] != without[-LABEL_PX:]).any() and not without[-LABEL_PX:].any()
    assert with_name[:LABEL_PX].any()


def test_a_run_without_masks_has_no_column_for_them():
    view = row(30, 90)
    sheet = sheet_of(view)
    assert sheet.shape[1] == 3 * (90 + GAP_PX) and titles("half", 9, "", masked=False)[2] == "error (brightest: 0.5)"
    assert (
        sheet[LABEL_PX + 10, 2 * (90 + GAP_PX) + 10].tolist() == error_picture(view.photo, view.render)[0, 0].tolist()
    )


def test_titles_say_which_look_is_shown_by_which_protocol_and_after_which_step():
    photo, render, _, error = titles("full", 600, "refined", masked=True)
    assert (photo, render) == ("photo (protocol full, step 600)", "render (refined)") and error.startswith(
        "error (refined;"
    )
    assert titles("full", 600, "", masked=True)[1::2] == ("render", "error (brightest: 0.5)")
    one, other = row(8, 300), replace(row(8, 300), look="zero_shot")
    refined, zero_shot = map(sheet_of, (one, other))
    places = [slice(column * (300 + GAP_PX), (column + 1) * (300 + GAP_PX)) for column in range(3)]
    assert [bool((refined[:, place] != zero_shot[:, place]).any()) for place in places] == [False, True, True]
    # Of a run with one look.
    assert picture_sheet([row_of(replace(one, look=None), "")], "half", 9).shape == refined.shape


def test_a_sheet_names_the_step_it_is_given():
    earlier, later = (picture_sheet([row_of(row(8, 300), "")], "half", step) for step in (111, 888))
    assert (earlier[:LABEL_PX, :300] != later[:LABEL_PX, :300]).any()


def test_errors_brighten_from_black_and_saturate():
    black = np.zeros((1, 5, 3), np.uint8)
    render = np.broadcast_to(np.array([0, 30, 90, 128, 255], np.uint8)[None, :, None], (1, 5, 3))
    brightness = error_picture(black, render)[0].astype(int).sum(axis=1)
    assert brightness[0] < 10
    assert (np.diff(brightness[:4]) > 0).all() and brightness[4] == brightness[3]


def test_rows_are_shrunk_before_they_wait_for_each_other():
    assert {tile.shape for tile in row_of(row(600, 800, np.ones((5, 8), np.float32)), "").tiles} == {(240, TILE_PX, 3)}


def test_views_are_kept_one_by_one_under_their_names(tmp_path):
    views = row(4, 6, name="day/a.jpg"), row(5, 4, name="b.png")
    places = png_paths(view.name for view in views)
    for view in views:
        write_view(tmp_path, places[view.name], view)
    names = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.png"))
    assert names == ["color/b.png", "color/day/a.png", "gt-color/b.png", "gt-color/day/a.png"]
    assert cv2.imread(str(tmp_path / "color/day/a.png"))[0, 0].tolist() == [25, 50, 100]
    assert cv2.imread(str(tmp_path / "gt-color/b.png")).shape == (5, 4, 3)


def test_kept_pictures_say_by_which_protocol_they_were_made_in_the_words_of_nerfbaselines(tmp_path):
    for protocol, theirs in (("half", "nerfw"), ("full", "default")):
        with pictures_kept(tmp_path / protocol, protocol) as folder:
            write_view(folder, Path("a.png"), row(4, 6))
        info = json.loads((tmp_path / protocol / "info.json").read_text())
        assert info == {"evaluation_protocol": theirs, "dataset_metadata": {"color_space": "srgb"}}
        assert (tmp_path / protocol / "gt-color" / "a.png").is_file()
