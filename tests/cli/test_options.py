"""Settings from presets, files and the command line: which beats which, and what is refused."""

from pathlib import Path

import pytest

from core.config import FIELDS, Settings
from core.errors import BadInput, BadSetting
from core.presets import PRESETS, preset
from core.rasterizer import BACKENDS
from wegs_cli.options import InputPath, OutputPath, settings_from

NOTHING: dict = {"steps": None, "seed": None}


def write_toml(tmp_path, text: str):
    path = tmp_path / "x.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_what_the_command_line_replaces_in_a_file_is_not_judged(tmp_path):
    path = write_toml(tmp_path, "densify_from = 0.7\nsteps = 0\n")
    settings = settings_from(None, path, ("densify_until=0.8",), {"steps": 100})
    assert (settings.densify_from, settings.densify_until, settings.steps) == (0.7, 0.8, 100)
    with pytest.raises(BadSetting, match="^.*x.toml: densify_from=0.7 is after densify_until=0.6"):
        settings_from(None, path, (), {"steps": 100})
    with pytest.raises(BadSetting, match="^sky_radius="):
        settings_from(None, write_toml(tmp_path, "seed = 1\n"), ("sky_radius=-1",), {})


def test_every_rasterizer_can_be_chosen():
    """core.config lists them without importing any, so that help comes at once."""
    assert FIELDS["backend"].metadata["choices"] == ("auto", *BACKENDS)


def test_an_output_behind_a_folder_that_is_not_there_is_the_one_it_leads_to(tmp_path, monkeypatch):
    (tmp_path / "runs" / "a").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "runs")
    for typed in ("a", "../runs/a", "new/b.ply"):
        assert OutputPath().convert(typed, None, None) == Path(typed)
    for typed in ("none/../a", "../runs/none/../a", "none/none/../../a/"):
        assert OutputPath().convert(typed, None, None) == (tmp_path / "runs" / "a").resolve()


def test_what_may_not_be_read_is_left_to_its_reader(tmp_path, monkeypatch):
    monkeypatch.setattr("os.access", lambda *_: False)
    assert InputPath().convert(str(tmp_path), None, None) == tmp_path


def test_without_any_argument_the_defaults_apply():
    assert settings_from(None, None, (), NOTHING) == Settings()


def test_command_line_beats_file_beats_preset_beats_default(tmp_path):
    path = write_toml(tmp_path, "max_gaussians = 77\nseed = 5\n")
    settings = settings_from("quick", path, ("sky=none",), {"steps": None, "seed": 9})
    assert settings.steps == PRESETS["quick"]["steps"] != Settings().steps  # the preset's, where nothing beats it
    assert settings.max_gaussians == 77 != PRESETS["quick"]["max_gaussians"]  # the file's
    assert settings.seed == 9  # the command line's
    assert settings.sky == "none" != Settings().sky
    assert settings.sh_degree == Settings().sh_degree


def test_a_falsy_value_counts_as_typed():
    assert settings_from(None, None, (), {"sh_degree": 0}).sh_degree == 0


@pytest.mark.parametrize(
    "text, name, value",
    [
        ("steps=7", "steps", 7),
        ("sh_degree=auto", "sh_degree", -1),
        ("steps=auto", "steps", -1),
        ("densify_from=auto", "densify_from", -1),
        ("mean_rate=1e-4", "mean_rate", 1e-4),
        ("gauge=1", "gauge", 1.0),
        ("channel-attention = off", "channel_attention", False),
        ("residual=true", "residual", True),
        ("mask=mlp", "mask", "mlp"),
    ],
)
def test_set_reads_a_value_in_the_type_of_its_setting(text, name, value):
    got = getattr(settings_from(None, None, (text,), {}), name)
    assert got == value and type(got) is type(value)


@pytest.mark.parametrize(
    "text, words",
    [
        ("steps", "^--set steps gives no value. Type: --set key=value$"),
        ("=3", "^--set =3 gives no setting. Type: --set key=value$"),
        ("residual=", "gives no value"),
        ("stepz=3", "no setting 'stepz'. Did you mean steps\\?$"),
        (
            "r=2",
            "no setting 'r'. Did you mean resolution, residual, residual_bound, reach, remove_veils, remove_passers_by\\?$",
        ),
        ("quality=high", "no setting 'quality'. `wegs train --help` lists them.$"),
        ("steps=many", "^steps=many is not a whole number. Give one of at least 1, or auto.$"),
        ("steps=1.5", "not a whole number"),
        ("sh_degree=high", "^sh_degree=high is not a whole number. Give one from 0 to 3, or auto.$"),
        ("ssim_weight=half", "^ssim_weight=half is not a finite number. Give one from 0 to 1.$"),
        ("resolution=0", "too small"),
        ("mean_rate=1e39", "^mean_rate=1e\\+39 is too large. Give one from 0 to 1.$"),
        ("steps=0", "^steps=0 is too small. Give one of at least 1, or auto.$"),
        ("gauge=nan", "gauge=nan"),
        ("sh_degree=4", "too large"),
        ("sh_degree=-2", "too small"),
        ("seed=auto", "not a whole number"),
        ("residual=maybe", "^residual=maybe is not true or false. Choose one of: true, false.$"),
        ("sky=blue", "^sky='blue' is not a choice. Choose one of: auto, none, dome.$"),
        ("mask_start=0.7", "mask_start=0.7 is after mask_apply=0.6. A mask must learn"),
    ],
)
def test_set_refuses_in_one_line(text, words):
    with pytest.raises(BadSetting, match=words) as caught:
        settings_from(None, None, (text,), {})
    assert "\n" not in str(caught.value)


def test_the_same_setting_twice_is_refused():
    with pytest.raises(BadSetting, match="steps is given twice"):
        settings_from(None, None, ("steps=3",), {"steps": 4})


@pytest.mark.parametrize(
    "text, error, words",
    [
        ("steps = \n", BadInput, "not TOML"),
        ("stepz = 3\n", BadSetting, "no setting 'stepz'. Did you mean steps?"),
        ("steps = '3'\n", BadSetting, "steps='3' is not a whole number. Give one of at least 1, or auto.$"),
        pytest.param(
            f"reach = 1{'0' * 400}\n",
            BadSetting,
            ": reach=10+ is not a finite number. Give one of at least 0.$",
            id="400 digits",
        ),
        (
            "largest_scale = true\n",
            BadSetting,
            "largest_scale=True is not a finite number. Give one of at least 0.001.$",
        ),
        ("residual = 1\n", BadSetting, "residual=1 is not true or false. Choose one of: true, false.$"),
        ("sky = 1\n", BadSetting, "sky=1 is not a word. Choose one of: auto, none, dome.$"),
        (
            "[training]\nsteps = 3\n",
            BadSetting,
            r"training is a table, and settings stand in none. Remove the line \[training\]",
        ),
    ],
)
def test_a_bad_file_is_refused(tmp_path, text, error, words):
    path = write_toml(tmp_path, text)
    with pytest.raises(error, match=words) as caught:
        settings_from(None, path, (), {})
    assert str(caught.value).startswith(str(path))


def test_a_file_may_name_a_preset_which_the_command_line_beats(tmp_path):
    path = write_toml(tmp_path, "preset = 'quick'\nseed = 7\n")
    assert settings_from(None, path, (), {}) == preset("quick").changed(seed=7)
    assert settings_from("paper", path, (), {}) == preset("paper").changed(seed=7)
    with pytest.raises(BadSetting, match="no preset 'fast'. Choose one of"):
        settings_from(None, write_toml(tmp_path, "preset = 'fast'\n"), (), {})


def test_a_file_may_begin_with_a_byte_order_mark(tmp_path):
    assert settings_from(None, write_toml(tmp_path, "\ufeffsteps = 7\n"), (), {}).steps == 7


def test_auto_in_a_file_leaves_it_to_the_photos(tmp_path):
    path = write_toml(tmp_path, "sh_degree = 'auto'\ngeometry_from = 'auto'\nappearance = 'auto'\n")
    settings = settings_from("paper", path, (), {})
    assert set(settings.undecided) == {"sh_degree", "geometry_from", "appearance", "transparency", "scale_rate"}
    assert settings.decided(appearance="off", transients="on", sh_degree=2).sh_degree == 2


def test_presets_leave_to_the_photos_what_they_do_not_say():
    assert settings_from(None, None, (), {}).undecided[:3] == ("appearance", "transients", "sh_degree")
    assert set(settings_from("vanilla", None, (), {}).undecided) & {"appearance", "transients"} == set()
    assert settings_from("paper", None, (), {}).undecided == ("transparency", "scale_rate")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(BadInput, match="none.toml"):
        settings_from(None, tmp_path / "none.toml", (), {})
