"""What each command asks of the pipeline."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from core import pipeline
from core.bench import FIGURES, suite
from core.config import PRESETS, Settings
from core.errors import BadInput
from core.report import Report
from wegs_cli.main import wegs


@pytest.fixture
def asked(monkeypatch):
    """The calls that reach the pipeline, which does nothing; reports are left out."""
    calls = []

    def recorder(name):
        def record(*arguments, **named):
            assert any(isinstance(value, Report) for value in arguments), name
            kept = [value for value in arguments if not isinstance(value, Report)]
            calls.append((name, *kept, *named.values()))

        return record

    for name in ("train", "resume", "export", "interpolate", "evaluate", "find_cameras"):
        monkeypatch.setattr(pipeline, name, recorder(name))
    for name in ("bench", "curves"):
        monkeypatch.setattr(suite, name, recorder(name))
    return calls


def invoke(*arguments: str):
    return CliRunner().invoke(wegs, list(arguments))


@pytest.mark.parametrize(
    "line, call",
    [
        ("train", ("train", Path("."), Settings(), None, False, None)),
        (
            "train plaza -o out --preset quick --steps 9 -r 2 --force",
            ("train", Path("plaza"), Settings(**PRESETS["quick"]).changed(steps=9, resolution=2), Path("out"), True, None),
        ),
        ("train --all-photos", ("train", Path("."), Settings(all_photos=True), None, False, None)),
        ("train plaza --masks people", ("train", Path("plaza"), Settings(), None, False, Path("people"))),
        ("train --set sky=none --sh-degree 0", ("train", Path("."), Settings(sky="none", sh_degree=0), None, False, None)),
        (
            "train --sh-degree auto --appearance exposure --transients off",
            ("train", Path("."), Settings(appearance="exposure", transients="off"), None, False, None),
        ),
        ("train --resume", ("resume", None)),
        ("train --resume -o runs/a", ("resume", Path("runs/a"))),
        ("bake --appearance a.jpg -o a.ply", ("export", None, "a.jpg", Path("a.ply"), False, None, True, None, True)),
        ("bake --appearance a.jpg -o a.ply --no-sky", ("export", None, "a.jpg", Path("a.ply"), False, None, True, None, False)),
        (
            "bake --appearance a.jpg -o a.ply --prune off",
            ("export", None, "a.jpg", Path("a.ply"), False, None, False, None, True),
        ),
        (
            "bake --appearance neutral -o a.ply --run r --force --save-appearance x",
            ("export", Path("r"), "neutral", Path("a.ply"), True, "x", True, None, True),
        ),
        ("bake --appearance a.jpg -o a.ply --mask m.png", ("export", None, "a.jpg", Path("a.ply"), False, None, True, Path("m.png"), True)),
        ("interpolate a b", ("interpolate", None, "a", "b", 10, None, None, False, False)),
        (
            "interpolate a b --steps 3 --view v.jpg --ply -o d --run r --force",
            ("interpolate", Path("r"), "a", "b", 3, Path("d"), "v.jpg", True, True),
        ),
        ("eval", ("evaluate", None, "half", True, False)),
        ("eval --run r --protocol full --no-refine --pictures", ("evaluate", Path("r"), "full", False, True)),
        ("eval --curve", ("curves", (), ("half", "full"), True)),
        (
            "eval --curve --run a --run b --protocol full --no-refine",
            ("curves", (Path("a"), Path("b")), ("full",), False),
        ),
        ("bench", ("bench", None, None, FIGURES, False, Path("bench"), False)),
        (
            "bench plaza --only baking --only training --full -o d --force",
            ("bench", Path("plaza"), None, ("baking", "training"), True, Path("d"), True),
        ),
        ("bench --run r", ("bench", None, Path("r"), FIGURES, False, Path("bench"), False)),
        ("sfm photos -o scene", ("find_cameras", Path("photos"), Path("scene"))),
    ],
)
def test_a_command_line_reaches_the_pipeline(asked, line, call):
    result = invoke(*line.split())
    assert result.exit_code == 0, result.output
    assert asked == [call]


@pytest.mark.parametrize(
    "extra", ["plaza --steps 3", "plaza -o run", "--steps 3", "--preset quick", "--set sky=none", "--config x.toml", "--force"]
)
def test_what_a_resumed_run_cannot_change_is_refused(asked, extra):
    result = invoke("train", "--resume", *extra.split())
    assert result.exit_code == 1 and "resumed run keeps" in result.stderr
    assert asked == []


def test_a_run_named_as_a_scene_is_told_how_to_go_on(asked):
    result = invoke("train", "--resume", "runs/a b")
    assert result.exit_code == 1 and "Type: wegs train --resume -o 'runs/a b'" in result.stderr and asked == []


def test_several_runs_are_measured_one_at_a_time(asked):
    result = invoke("eval", "--run", "a", "--run", "b")
    assert result.exit_code == 1 and "--curve" in result.stderr
    assert asked == []


def test_an_error_of_the_pipeline_is_one_line(monkeypatch):
    def fail(*_):
        raise BadInput("There is no folder plaza.", "Give another.")

    monkeypatch.setattr(pipeline, "train", fail)
    result = invoke("train", "plaza")
    assert (result.exit_code, result.stderr) == (1, "wegs: There is no folder plaza. Give another.\n")
