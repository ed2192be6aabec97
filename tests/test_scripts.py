"""All scripts in samples/ begin alike and describe themselves, and what documents tell to type can be typed."""

import os
import re
import shlex
import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

ROOT = Path(__file__).parents[1]
SCRIPTS = sorted((ROOT / "samples").glob("*.py"))
DOCUMENTS = [ROOT / "README.md", ROOT / "samples" / "README.md", *(ROOT / "core").glob("*.md"), *SCRIPTS]
# In a code span of Markdown, or on an indented line.
TYPED = re.compile(r"python samples/(\w+)\.py([^`]*)`|^ {4}.*python samples/(\w+)\.py(.*)$", re.MULTILINE)


def commands() -> list[tuple[str, str]]:
    """The scripts that documents call, with what is typed behind their names."""
    found = (match.groups() for path in DOCUMENTS for match in TYPED.finditer(path.read_text(encoding="utf-8")))
    return sorted({(first or second, " ".join((span or line or "").split())) for first, span, second, line in found})


@pytest.mark.parametrize("script, typed", commands())
def test_command_lines_in_documents_are_understood(script, typed):
    command = import_module(f"samples.{script}").main
    context = click.Context(command)
    given, left, _ = command.make_parser(context).parse_args(shlex.split(typed, comments=True))
    assert not left
    for option in command.params:
        if isinstance(option.type, click.Choice) and isinstance(value := given.get(option.name), (str, list, tuple)):
            option.type_cast_value(context, value)


def test_every_script_has_its_line_in_the_readme():
    text = (ROOT / "samples" / "README.md").read_text(encoding="utf-8")
    assert [path.name for path in SCRIPTS if f"`{path.name}`" not in text] == []


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_help_says_what_a_script_does(script):
    command = import_module(f"samples.{script.stem}").main
    told = CliRunner().invoke(command, ["--help"])
    assert told.exit_code == 0 and all(option.help for option in command.params if isinstance(option, click.Option))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_ctrl_c_while_a_script_is_loaded_ends_it_without_a_traceback(script, tmp_path):
    (tmp_path / "click.py").write_text("raise KeyboardInterrupt")
    ended = subprocess.run(
        [sys.executable, script],
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (-signal.SIGINT, "", "")


def test_other_errors_keep_their_traceback(tmp_path):
    (tmp_path / "click.py").write_text("raise ValueError")
    ended = subprocess.run(
        [sys.executable, SCRIPTS[0]],
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 1 and ended.stderr.endswith("ValueError\n")
