"""All scripts in samples/ begin alike and describe themselves; what documents and help tell to type can be typed."""

import os
import re
import shlex
import signal
import subprocess
import sys
from importlib import import_module
from itertools import product
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from wegs_cli.main import COMMANDS, wegs
from wegs_cli.options import Number, settings_from

ROOT = Path(__file__).parents[1]
SCRIPTS = sorted((ROOT / "samples").glob("*.py"))
DOCUMENTS = [ROOT / "README.md", ROOT / "samples" / "README.md", *(ROOT / "core").glob("*.md"), *SCRIPTS]
DOCUMENTS += sorted((ROOT / "wegs_cli").glob("*.py"))  # their help
# Where documents have code: a line of a block, fenced or indented, or a span, which may go on on the next line.
FENCED = re.compile(r"^```\w*\n(.*?)^```", re.MULTILINE | re.DOTALL)
INDENTED, SPAN = re.compile(r"^ {4}(.*)$", re.MULTILINE), re.compile(r"`([^`]+)`")
SCRIPT = re.compile(r".*python samples/(\w+)\.py(.*)")
COMMAND = re.compile(r"(?:\S*/)?wegs (?:--memory \d+ )?([a-z]+)(.*)")
OPTIONS = re.compile(r"((?:--|-r )\w[^,]*)$")


def typed(pattern: re.Pattern) -> list[tuple[str, ...]]:
    """What the groups of the pattern find in the commands of all documents, each command from its beginning."""
    found = set()
    for path in DOCUMENTS:
        text = path.read_text(encoding="utf-8")
        blocks, rest = FENCED.findall(text), FENCED.sub("", text)
        pieces = [*"\n".join(blocks).splitlines(), *INDENTED.findall(rest), *SPAN.findall(rest)]
        for command in (part for piece in pieces for part in " ".join(piece.split()).split(" && ")):
            found |= {match.groups()} if (match := pattern.match(command)) else set()
    return sorted(found)


def check(command: click.Command, line: str) -> None:
    """Raise click.UsageError unless the command understands the line; in it, `a|b` stands for either, and an option at
    the end may lack its value."""
    context, words = click.Context(command), shlex.split(line, comments=True)
    valued = {name for option in command.params if not getattr(option, "is_flag", False) for name in option.opts}
    if words and words[-1] in valued:
        words.pop()
    for chosen in product(*(word.split("|") for word in words)):
        given, left, _ = command.make_parser(context).parse_args(list(chosen))
        if left:
            raise click.UsageError(f"Got unexpected extra arguments: {left}", context)
        for option in command.params:
            if isinstance(value := given.get(option.name), (str, list, tuple)):
                if isinstance(option.type, (click.Choice, Number)):
                    option.type_cast_value(context, value)
                if option.name == "assignments" and value != ["key=value"]:
                    settings_from(None, None, tuple(value), {})


@pytest.mark.parametrize("script, line", typed(SCRIPT))
def test_command_lines_in_documents_are_understood(script, line):
    check(import_module(f"samples.{script}").main, line)


@pytest.mark.parametrize("name, line", typed(COMMAND))
def test_commands_in_documents_are_understood(name, line):
    check(wegs.get_command(click.Context(wegs), name), line)


@pytest.mark.parametrize("line", [line for (line,) in typed(OPTIONS)])
def test_options_in_documents_are_those_of_a_command_or_a_script(line):
    refused = 0
    commands = [wegs, *(wegs.get_command(click.Context(wegs), name) for name in COMMANDS)]
    commands += [import_module(f"samples.{path.stem}").main for path in SCRIPTS]
    for command in commands:
        try:
            check(command, line)
        except click.UsageError:
            refused += 1
    assert refused < len(commands)


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
