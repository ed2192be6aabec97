"""Help: every command has it, with an example; it is made from core.config and comes at once."""

import subprocess
import sys

import click
import pytest
from click.testing import CliRunner

import core
from core.config import FIELDS
from core.presets import PRESETS
from tests.paths import ROOT
from tests.programs import run_python
from wegs_cli.main import COMMANDS, wegs
from wegs_cli.options import FLAGS, shown_default


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_with_an_example(name):
    result = CliRunner().invoke(wegs, [name, "--help"])
    assert result.exit_code == 0
    assert "Example" in result.output and f"wegs {name}" in result.output
    command = wegs.get_command(click.Context(wegs), name)
    assert command.name == name and command.short_help
    for parameter in command.params:
        assert isinstance(parameter, click.Argument) or parameter.help, f"{name} {parameter.name} has no help"


def test_the_group_names_every_command():
    result = CliRunner().invoke(wegs, ["--help"])
    assert result.exit_code == 0
    assert all(f"  {name} " in result.output for name in COMMANDS)


def test_no_command_at_all_shows_help_as_a_wrong_command_line():
    result = CliRunner().invoke(wegs, [])
    assert result.exit_code == 2 and "Commands:" in result.output


def test_train_help_shows_every_setting_with_default_and_help():
    output = CliRunner().invoke(wegs, ["train", "--help"]).output
    in_one = "".join(output.split())  # wherever its lines are broken
    for name, item in FIELDS.items():
        assert f"  {name} = {str(shown_default(name)).lower()}  " in output
        assert in_one.count("".join(item.metadata["help"].split())) == 1, f"the help of {name} stands there once"
        assert "|".join(item.metadata["choices"]) in in_one
    for name in FLAGS:
        assert f"See --{name.replace('_', '-')}." in output
    assert f"[{'|'.join(PRESETS)}]" in output


@pytest.mark.parametrize("name", COMMANDS)
def test_no_line_of_help_is_wider_than_the_terminal(name):
    assert max(map(len, CliRunner().invoke(wegs, [name, "--help"], terminal_width=80).output.splitlines())) <= 80


def test_the_settings_stand_under_headings():
    lines = [
        line.partition("  ")[0]
        for line in CliRunner().invoke(wegs, ["train", "--help"]).output.replace("\n  ", "\n").splitlines()
    ]
    for heading, first in (
        ("The run:", "steps = auto"),
        ("Losses:", "ssim_weight = 0.2"),
        ("Schedule:", "coarse_until = 0.2"),
    ):
        assert lines[lines.index(heading) - 1] == "" and lines[lines.index(heading) + 1] == first
    assert lines.index("Losses:") < lines.index("gauge = 0.01") < lines.index("Learning rates (Adam):")


def test_the_version_is_the_engines():
    result = CliRunner().invoke(wegs, ["--version"])
    assert (result.exit_code, result.output) == (0, f"wegs {core.__version__}\n")


def test_the_program_can_be_run_as_a_module():
    done = subprocess.run(
        [sys.executable, "-m", "wegs_cli", "--version"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout == f"wegs {core.__version__}\n"


def test_help_loads_nothing_heavy():
    # Each of these takes a tenth of a second to two seconds to import; help that waits for them feels broken.
    program = (
        "import sys\nfrom click.testing import CliRunner\nfrom wegs_cli.main import COMMANDS, wegs\n"
        "for name in COMMANDS: assert CliRunner().invoke(wegs, [name, '--help']).exit_code == 0\n"
        "print([m for m in ('torch', 'numpy', 'numba', 'cv2', 'pycolmap', 'rich', 'jaxtyping', 'matplotlib') if m in sys.modules])"
    )
    done = run_python(program)
    assert done.stdout.strip() == "[]"
