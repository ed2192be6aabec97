"""What each command asks of the pipeline."""

from inspect import signature
from pathlib import Path

import pytest
from click.testing import CliRunner

from core import pipeline
from core.bench import FIGURES, suite
from core.config import Settings
from core.errors import BadInput
from core.presets import preset
from core.report import Report
from tests.failing import failing
from wegs_cli.main import wegs


@pytest.fixture
def asked(monkeypatch):
    """The calls that reach the pipeline, which does nothing:
    what each asks beyond the defaults. Reports are left out."""
    calls = []

    def recorder(name, function):
        def record(*arguments, **named):
            given = signature(function).bind(*arguments, **named).arguments
            assert isinstance(given.pop("report"), Report), name
            defaults = {item.name: item.default for item in signature(function).parameters.values()}
            calls.append((name, {item: value for item, value in given.items() if value != defaults[item]}))

        return record

    for name in pipeline.__all__:
        monkeypatch.setattr(pipeline, name, recorder(name, getattr(pipeline, name)))
    for name in ("bench", "curves"):
        monkeypatch.setattr(suite, name, recorder(name, getattr(suite, name)))
    return calls


def invoke(*arguments: str):
    return CliRunner().invoke(wegs, list(arguments))


LOOK = {"folder": None, "appearance": "a.jpg", "output": Path("a.ply")}
HERE = {"scene": Path("."), "settings": Settings()}
BENCH = {"scene": None, "run_folder": None, "names": FIGURES, "full": False, "output": Path("bench")}


@pytest.mark.parametrize(
    "line, name, call",
    [
        ("train", "train", HERE),
        (
            "train plaza -o out --preset quick --steps 9 -r 2 --force",
            "train",
            {
                "scene": Path("plaza"),
                "settings": preset("quick").changed(steps=9, resolution=2),
                "output": Path("out"),
                "force": True,
            },
        ),
        ("train --all-photos", "train", HERE | {"settings": Settings(all_photos=True)}),
        ("train plaza --masks people", "train", HERE | {"scene": Path("plaza"), "masks": Path("people")}),
        ("train --set sky=none --sh-degree 0", "train", HERE | {"settings": Settings(sky="none", sh_degree=0)}),
        (
            "train --sh-degree auto --appearance exposure --transients off",
            "train",
            HERE | {"settings": Settings(appearance="exposure", transients="off")},
        ),
        *(
            (f"train {size}", "train", HERE)
            for size in ("-r auto", "-r -1", "--set resolution=auto", "--set resolution=-1")
        ),
        ("train --resume", "resume", {"folder": None}),
        ("train --resume -o runs/a", "resume", {"folder": Path("runs/a")}),
        ("bake --appearance a.jpg -o a.ply", "bake_to_file", LOOK),
        ("bake --appearance a.jpg -o a.ply --no-sky", "bake_to_file", LOOK | {"with_sky": False}),
        ("bake --appearance a.jpg -o a.ply --prune off", "bake_to_file", LOOK | {"prune": False}),
        ("bake --appearance a.jpg -o a.ply --mask m.png", "bake_to_file", LOOK | {"mask": Path("m.png")}),
        (
            "bake --appearance neutral -o a.ply --run r --force --save-appearance x",
            "bake_to_file",
            LOOK | {"folder": Path("r"), "appearance": "neutral", "force": True, "save_as": "x"},
        ),
        ("bake --appearance a.jpg -o a.ply --no-refine", "bake_to_file", LOOK | {"refine": False}),
        ("interpolate a b --no-refine", "interpolate", {"folder": None, "first": "a", "last": "b", "refine": False}),
        ("interpolate a b", "interpolate", {"folder": None, "first": "a", "last": "b"}),
        (
            "interpolate a b --steps 3 --view v.jpg --ply -o d --run r --force",
            "interpolate",
            {
                "folder": Path("r"),
                "first": "a",
                "last": "b",
                "steps": 3,
                "output": Path("d"),
                "views": ("v.jpg",),
                "ply": True,
                "force": True,
            },
        ),
        ("eval", "evaluate", {"folder": None}),
        (
            "eval --run r --protocol full --no-refine --pictures",
            "evaluate",
            {"folder": Path("r"), "protocol": "full", "refine": False, "keep_pictures": True},
        ),
        ("eval --curve", "curves", {"runs": (), "protocols": ("half", "full"), "refine": True}),
        (
            "eval --curve --run a --run b --protocol full",
            "curves",
            {"runs": (Path("a"), Path("b")), "protocols": ("full",), "refine": True},
        ),
        ("eval --curve --no-refine", "curves", {"runs": (), "protocols": ("half", "full"), "refine": False}),
        ("bench", "bench", BENCH),
        (
            "bench plaza --only baking --only training --full -o d --force",
            "bench",
            BENCH
            | {
                "scene": Path("plaza"),
                "names": ("baking", "training"),
                "full": True,
                "output": Path("d"),
                "force": True,
            },
        ),
        ("bench --run r", "bench", BENCH | {"run_folder": Path("r")}),
        ("sfm photos -o scene", "find_cameras", {"photos": Path("photos"), "output": Path("scene")}),
    ],
)
def test_a_command_line_reaches_the_pipeline(asked, line, name, call):
    result = invoke(*line.split())
    assert result.exit_code == 0, result.output
    assert asked == [(name, call)]


@pytest.mark.parametrize(
    "extra",
    ["plaza --steps 3", "plaza -o run", "--steps 3", "--preset quick", "--set sky=none", "--config x.toml", "--force"],
)
def test_what_a_resumed_run_cannot_change_is_refused(asked, extra):
    result = invoke("train", "--resume", *extra.split())
    assert (
        result.exit_code == 1
        and "has no effect on a resumed run" in result.stderr
        and "train a new run" in result.stderr
    )
    assert asked == []


def test_a_run_given_as_a_scene_is_refused_with_the_right_command(asked, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("runs/a b").mkdir(parents=True)
    Path("runs/a b/config.json").write_text('{"wegs": "0.1.0"}')
    result = invoke("train", "--resume", "runs/a b")
    assert result.exit_code == 1 and "Type: wegs train --resume -o 'runs/a b'" in result.stderr and asked == []


@pytest.mark.parametrize(
    "line, told",
    [("train plaza --force", "there is no -o"), ("eval --curve --no-refine --protocol full", "Leave --protocol out")],
)
def test_an_option_that_would_have_no_effect_is_refused(asked, line, told):
    result = invoke(*line.split())
    assert result.exit_code == 1 and told in result.stderr and asked == []


def test_several_runs_are_measured_one_at_a_time(asked):
    result = invoke("eval", "--run", "a", "--run", "b")
    assert result.exit_code == 1 and "--curve" in result.stderr
    assert asked == []


def test_figures_are_drawn_or_pictures_kept(asked):
    result = invoke("eval", "--curve", "--pictures")
    assert result.exit_code == 1 and "Type one of them." in result.stderr and asked == []


def test_an_error_of_the_pipeline_is_one_line(monkeypatch):
    monkeypatch.setattr(pipeline, "train", failing(BadInput("There is no folder plaza.", "Give another.")))
    result = invoke("train", "plaza")
    assert (result.exit_code, result.stderr) == (1, "wegs: There is no folder plaza. Give another.\n")
