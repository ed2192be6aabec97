"""The command group, and how errors end it: a user's mistake in one line, a defect of wegs in a traceback."""

import errno
import importlib.util
import os
import sys
from collections.abc import Callable
from importlib import import_module
from io import TextIOWrapper
from pathlib import Path
from typing import Any, NoReturn

import click

from wegs_cli import INTERRUPTED

# Command -> function. None of these modules imports torch before its command runs.
COMMANDS = {
    "train": "wegs_cli.train:train",
    "bake": "wegs_cli.bake:bake",
    "interpolate": "wegs_cli.interpolate:interpolate",
    "eval": "wegs_cli.evaluate:evaluate",
    "bench": "wegs_cli.bench:bench",
    "sfm": "wegs_cli.sfm:sfm",
    "doctor": "wegs_cli.doctor:doctor",
}
UNUSABLE = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENAMETOOLONG)


class OneLineErrors(click.Command):
    """A command that ends with one line and an exit code, not a traceback,
    where the user can correct what went wrong."""

    def main(self, *args: Any, at_end: Callable[[], None] = lambda: None, **extra: Any) -> NoReturn:
        """Run and exit: 0, 1 for a WegsError, 2 for a wrong command line, 130 for Ctrl-C.
        at_end: called before the one line."""
        try:
            code = super().main(*args, **(extra | {"standalone_mode": False}))
        except click.exceptions.NoArgsIsHelpError as help_wanted:
            help_wanted.show()
            sys.exit(help_wanted.exit_code)
        except BaseException as problem:
            from core.words import on_one_line  # late, as in `explain`

            answer = explain(problem)
            if answer is None:
                raise
            at_end()
            line, code = answer
            say_last(on_one_line(line))
        sys.exit(code if isinstance(code, int) else 0)


class Group(OneLineErrors, click.Group):
    """Imports a command from COMMANDS only when it is used.
    From the names in `commands`, click suggests one if a word is mistyped."""

    def list_commands(self, context: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        module, function = COMMANDS[name].split(":")
        return getattr(import_module(module), function)


def explain(problem: BaseException) -> tuple[str, int] | None:
    """The line and the exit code for an exception that the user can do something about; None for a defect of wegs."""
    # Late: not before `run` has checked that this core is wegs'.
    from core.errors import WegsError, as_disk_full, as_out_of_memory

    if isinstance(problem, WegsError):
        return str(problem), 1
    if isinstance(problem, click.ClickException):
        return _explain_command_line(problem), problem.exit_code
    if isinstance(problem, (click.Abort, KeyboardInterrupt)):
        # click turns every Ctrl-C into an Abort, whose cause is the KeyboardInterrupt that says what was kept.
        first = problem.__cause__ or problem
        return " ".join(["Stopped.", *map(str, first.args)]), INTERRUPTED
    if error := as_disk_full(problem) or as_out_of_memory(problem):
        return str(error), 1
    if isinstance(problem, OSError) and problem.errno in UNUSABLE and problem.filename:
        return f"{problem.filename}: {problem.strerror}. Choose another path, or change who may use this one.", 1
    if isinstance(problem, OSError) and problem.errno == errno.EIO and problem.filename:
        return f"{problem.filename}: {problem.strerror}. Check its disk, or choose another path.", 1
    if isinstance(problem, UnicodeEncodeError):
        words = ascii(problem.object[max(0, problem.start - 60) : problem.end])
        return f"{words} cannot be written as {problem.encoding}. Rename the file or folder.", 1
    # From Numba, if neither its package's folder nor the home folder is writable, as in containers run by another user.
    if isinstance(problem, RuntimeError) and "no locator available" in str(problem):
        return "There is no folder for compiled kernels. Set NUMBA_CACHE_DIR to one that may be written.", 1
    # From Path.resolve, up to Python 3.12.
    if isinstance(problem, RuntimeError) and str(problem).startswith("Symlink loop"):
        return f"{problem}. Choose another path.", 1
    return None


def _explain_command_line(problem: click.ClickException) -> str:
    """What click says of a command line, in one line, and what to type."""
    context = getattr(problem, "ctx", None)
    advice = f" Try: {context.command_path} --help" if context else ""
    if isinstance(problem, click.NoSuchOption) and problem.option_name == "--memory":
        advice = " It goes before the command: wegs --memory GIB train ..."
    # click's names of types.
    message = problem.format_message().replace("float range", "number").replace("integer range", "whole number")
    takes_run = context and any("--run" in each.opts for each in context.command.params)
    if takes_run and message.startswith("Got unexpected extra argument"):
        advice = f" A run is named by --run.{advice}"
    stop = "" if message.endswith((".", "?", "?)")) else "."
    return " ".join(message.split()) + stop + advice


def foreign_core() -> str | None:
    """Where `core` is imported from, if that is not the engine beside this command line; else None."""
    found = importlib.util.find_spec("core")
    here = Path(__file__).resolve().parent.parent
    if found is None:
        return "nowhere"
    origin = Path(found.origin).resolve() if found.origin else None
    if origin == here / "core" / "__init__.py" and (here / "core" / "errors.py").is_file():
        return None
    return str(origin or next(iter(found.submodule_search_locations or ["an unknown place"])))


def _show_version(context: click.Context, _parameter: click.Parameter, wanted: bool) -> None:
    if wanted:
        import core

        click.echo(f"wegs {core.__version__}")
        context.exit()


@click.group(
    cls=Group, commands=COMMANDS, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110}
)
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_show_version, help="Show the version."
)
@click.option(
    "--memory",
    type=click.FloatRange(min=2),
    metavar="GIB",
    help="Never use more main memory than this (Linux only); a GPU's own memory is not limited.",
)
def wegs(memory: float | None) -> None:
    """From tourist photos to a 3D Gaussian scene whose look follows any photo.

    \b
    wegs doctor photos/                           # can all photos be read? how long will it take?
    wegs train photos/                            # writes runs/photos: minutes to hours on two cores
    wegs bake --appearance dusk.jpg -o dusk.ply   # the scene in the look of a photo, for any 3DGS viewer

    Type `wegs COMMAND --help` for the options of a command.
    """
    if memory is not None:
        from core.system.memory import hold_to  # late: not before `run` has checked that this core is wegs'

        hold_to(memory)


def say_last(line: str) -> None:
    """Print the line that the program ends with."""
    line = f"wegs: {line}"
    click.echo(line if os.environ.get("NO_COLOR") else click.style(line, fg="red"), err=True)


def run() -> None:
    """The console command `wegs`."""
    try:
        os.getcwd()
    except FileNotFoundError:  # Python would find no module there, and torch would not load
        sys.exit("wegs: The folder you are in was removed. Type: cd, or go to another.")
    origin = foreign_core()
    if origin is not None:
        line = f"wegs: The package `core` comes from {origin}, not from wegs."
        sys.exit(f"{line} Install wegs in a virtual environment of its own, and unset PYTHONPATH.")
    from core.system.process import prepare  # only now is `core` known to be ours
    from wegs_cli.stops import end_at_once, ignore_stops

    # Streams are None if they were closed, as some schedulers do. What stands for them stays open to the end.
    sys.stdout, sys.stderr = (stream or open(os.devnull, "w") for stream in (sys.stdout, sys.stderr))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            # A character that the terminal cannot show appears as its code.
            stream.reconfigure(errors="backslashreplace")
    end_at_once()
    prepare()
    wegs(prog_name="wegs", at_end=ignore_stops)
