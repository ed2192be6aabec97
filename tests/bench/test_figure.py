"""Figures as data: spreads, fronts, verdicts, and the files they become."""

import csv
import io
import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from core.bench import files
from core.bench.figure import Figure, Panel, Point, Quantity, Spread
from core.errors import BadInput, BadSetting
from tests.failing import failing
from tests.heard import Heard
from tests.programs import run_python

WORK = Quantity("seconds", "s", "log")
ERROR = Quantity("error", "error", "log", limit=(0.1, "a limit"), floor=1e-6)
QUALITY = Quantity("quality", "dB", more_is_better=True)
MADE_ON = {"cpu": "Some, CPU", "threads": "2", "wegs": "1", "seed": "7"}


def point(
    label: str, work: float, error: float, curve: str = "a", is_default: bool = False, quality: float | None = None
):
    values = {"seconds": Spread.exactly(work), "error": Spread.exactly(error)}
    if quality is not None:
        values["quality"] = Spread(quality, quality - 1, quality + 1)
    return Point(curve, label, values, is_default)


def figure(*points: Point) -> Figure:
    panels = Panel("seconds", "error"), Panel("seconds", "quality")
    return Figure("test", "A test", (WORK, ERROR, QUALITY), panels, points, MADE_ON, ("A note.",))


def labels(points: list[Point]) -> list[str]:
    return [point.label for point in points]


def test_a_spread_is_median_and_quartiles_in_any_order():
    spread = Spread.of([5.0, 1.0, 2.0, 4.0, 3.0])
    assert (spread.low, spread.median, spread.high) == (2.0, 3.0, 4.0)
    assert spread.words() == "3 (2 to 4)" and Spread.exactly(0.12345).words() == "0.123"
    assert Spread.exactly(12573).words() == "12573"


def test_the_front_holds_what_nothing_beats():
    made = figure(
        point("slow and exact", 9, 0), point("fast and rough", 1, 0.5), point("beaten", 9, 0.1), point("worse", 2, 0.6)
    )
    assert labels(made.front(made.panels[0])) == ["fast and rough", "slow and exact"]
    assert labels(made.beaten_by(made.points[2], made.panels[0])) == ["slow and exact"]


def test_more_is_better_where_the_quantity_says_so_and_equals_do_not_beat_each_other():
    made = figure(
        point("good", 1, 1, quality=20),
        point("same", 1, 1, quality=20),
        point("bad", 1, 1, quality=10),
        point("?", 1, 1),
    )
    assert labels(made.front(made.panels[1])) == ["good", "same"]  # what was not measured is not there


def test_a_verdict_says_where_the_default_lies():
    made = figure(point("x", 1, 0.2), point("y", 2, 0.3, is_default=True, quality=1))
    error, quality = made.verdicts()
    assert error == "error over s: a: y is beaten by 1, such as a: x."
    assert quality == "dB over s: a: y is on the front."
    assert figure(point("x", 1, 0.2)).verdicts() == []


def test_a_default_on_several_curves_is_as_good_as_its_best_measurement():
    made = figure(point("x", 1.0, 0.2, "a", True), point("x", 1.1, 0.2, "b", True))
    assert made.verdicts()[0] == "error over s: the default is on the front."


def test_an_empty_figure_is_refused():
    with pytest.raises(BadInput, match="nothing to draw"):
        figure()


# --- files

POINTS = (
    point("x", 0.001, 0.0, quality=-3.0),
    point("y", 0.1, 1e-9, is_default=True, quality=20.0),
    point("z", 10.0, 0.5, "b"),
)


def test_csv_and_json_hold_the_points_the_fronts_and_the_machine(tmp_path):
    made = figure(*POINTS)
    paths = files.save(made, tmp_path / "new")
    assert [path.name for path in paths] == ["test.csv", "test.json", "test.png"]
    rows = list(csv.DictReader(io.StringIO(paths[0].read_text())))
    assert [row["choice"] for row in rows] == ["x", "y", "z"]
    assert [row["default"] for row in rows] == ["0", "1", "0"]
    assert float(rows[1]["quality_low"]) == 19 and rows[2]["quality"] == ""
    assert [row["front_error_over_seconds"] for row in rows] == ["1", "0", "0"]
    assert {row["cpu"] for row in rows} == {"Some, CPU"} and {row["seed"] for row in rows} == {"7"}
    value = json.loads(paths[1].read_text())
    assert value["made_on"] == MADE_ON and value["notes"] == ["A note."]
    assert [entry["fronts"] for entry in value["points"]] == [[1, 2], [2], []]
    assert value["points"][1]["values"]["quality"] == {"median": 20, "low": 19, "high": 21}
    assert value["verdicts"] == made.verdicts()


def test_fronts_are_searched_once_a_panel_however_many_points_there_are(monkeypatch):
    searched, front = [], Figure.front
    monkeypatch.setattr(Figure, "front", lambda made, panel: searched.append(panel) or front(made, panel))
    made = figure(*POINTS)
    for form in (files.csv_of, files.json_of, lambda figure: files.show(figure, Heard())):
        searched.clear()
        form(made)
        assert searched == list(made.panels)


def test_a_part_of_a_figure_is_not_left_in_the_way(tmp_path, monkeypatch):
    interrupt = failing(KeyboardInterrupt)
    made = figure(*POINTS)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(files, "draw_png", interrupt)
        files.save(made, tmp_path)
    assert list(tmp_path.iterdir()) == []
    before = {path: path.read_bytes() for path in files.save(made, tmp_path)}
    monkeypatch.setattr(files, "draw_png", interrupt)
    with pytest.raises(KeyboardInterrupt):  # nor does it take the place of a whole one
        files.save(replace(made, title="Another"), tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_the_picture_shows_every_curve_in_its_colour_and_the_front(tmp_path):
    from core.bench.drawing import COLOURS, FRONT

    path = files.save(figure(*POINTS), tmp_path)[2]
    pixels = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
    for colour in (COLOURS[0], COLOURS[1], FRONT):
        wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
        # Lines are drawn at 0.9 of full cover over white, and their rims are smoothed: near is enough, absence is not.
        near = (np.abs(pixels.astype(int) - wanted).max(axis=2) < 30).sum()
        assert near > 20, colour


def test_no_label_stands_nearer_to_another_point(monkeypatch):
    from core.bench import drawing

    def checked(axis, figure, panel):
        label_points(axis, figure, panel)
        middles = {
            one.label: axis.transData.transform([one.values[name].median for name in (panel.x, panel.y)])
            for one in figure.points
        }
        for text in axis.texts:
            if text.get_text() in middles:
                box = text.get_window_extent()
                nearest[text.get_text()] = min(
                    middles, key=lambda name: math.dist(middles[name], ((box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2))
                )

    label_points, nearest = drawing._label_points, {}
    monkeypatch.setattr(drawing, "_label_points", checked)
    steps = (
        point("128 steps", 0.55, 1, quality=1.08),
        point("160 steps", 0.91, 1, quality=1.7),
        point("192 steps", 1.27, 1, "a", True, 1.77),
    )
    files.draw_png(
        replace(figure(point("0 steps", 0.015, 1, quality=0), *steps), panels=(Panel("seconds", "quality"),))
    )
    assert nearest == {name: name for name in ("0 steps", "128 steps", "160 steps", "192 steps")}


def test_runs_are_drawn_by_their_names_whatever_these_are(monkeypatch):
    """matplotlib sets what stands between two dollars as mathematics, and hides labels that begin with "_"."""
    from matplotlib.legend import Legend

    drawn, draw = [], Legend.draw
    monkeypatch.setattr(Legend, "draw", lambda legend, *given: (drawn.extend(legend.get_texts()), draw(legend, *given)))
    made = figure(point("x", 0.1, 1e-3, "a$_$b"), point("x", 0.2, 1e-3, "_old"), point("x", 0.3, 1e-3, "$5 to $6"))
    assert files.draw_png(replace(made, title="Training: $_$")).startswith(b"\x89PNG")
    assert {"a$_$b", "_old", "$5 to $6"} <= {text.get_text().strip() for text in drawn}


def test_values_below_zero_stay_where_they_are():
    """Only a logarithmic axis has a floor: a loss of 3 dB must not be drawn as none."""
    from core.bench.drawing import _floor, _place

    shown = [POINTS[0], POINTS[1]]
    assert _place(POINTS[0], QUALITY, _floor(QUALITY, shown)) == -3.0
    assert [_place(point, ERROR, _floor(ERROR, list(POINTS))) for point in POINTS] == [1e-6, 1e-6, 0.5]
    exact = point("exact", 1, 0.0)
    assert _floor(ERROR, [exact]) == ERROR.floor
    assert _floor(replace(ERROR, floor=0.0), [exact]) == -math.inf


def test_figures_are_not_replaced_unasked(tmp_path):
    (tmp_path / "test.json").write_text("{}")
    with pytest.raises(BadInput, match="--force"):
        files.check_free(tmp_path, ("other", "test"), force=False)
    files.check_free(tmp_path, ("other", "test"), force=True)
    files.check_free(tmp_path, ("other",), force=False)
    with pytest.raises(BadSetting, match="figures go into a folder"):
        files.check_free(tmp_path / "a.png", ("other",), force=False)
    with pytest.raises(BadInput, match="test.json is not a folder"):
        files.check_free(tmp_path / "test.json" / "figures", ("other",), force=True)


def test_the_table_has_a_column_for_each_quantity_and_says_what_it_was_made_on():
    heard = Heard()
    files.show(figure(*POINTS), heard)
    assert "curve: choice: s: error: dB: on the front of" in heard.lines
    assert "a: y (default): 0.1: 1e-09: 20 (19 to 21): 2" in heard.lines
    assert any(line.startswith("b: z: ") and line.endswith(": -: ") for line in heard.lines)
    assert any("Some, CPU" in line and "seed 7" in line for line in heard.lines)


def test_a_home_that_cannot_be_written_in_does_no_harm(tmp_path):
    (tmp_path / "file").touch()
    program = "from core.bench.files import draw_png; from tests.bench.test_figure import figure, point; draw_png(figure(point('a', 1, 1)))"
    assert run_python(program, MPLCONFIGDIR=str(tmp_path / "file" / "matplotlib")).stderr == ""
