"""Arguments that several scripts take, the same in each. Use them as decorators, as those of click."""

from collections.abc import Callable
from pathlib import Path

import click

from core import presets
from core.config import FIELDS, Settings
from core.evaluation import PROTOCOLS
from core.presets import PRESETS
from core.setting import AUTO
from wegs_cli.options import Number

PATH = click.Path(path_type=Path)
AT_LEAST_ONE = click.IntRange(min=1)
Decorator = Callable[[Callable], Callable]

scene = click.argument("scene", type=PATH)
# All are there, or none is begun with.
scenes = click.argument(
    "scenes", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True, file_okay=False)
)
run = click.argument("run_folder", metavar="[RUN]", type=PATH, required=False)
preset = click.option(
    "--preset",
    "preset_name",
    default="quick",
    show_default=True,
    type=click.Choice(sorted(PRESETS)),
    help="As of `wegs train`.",
)

json_file = click.option("--json", "file", type=PATH, help="Write the figures into this file as well.")


def steps(default: int | None = None) -> Decorator:
    """Without a default, the steps are the preset's."""
    known = {"default": default, "show_default": True} if default else {"show_default": "the preset's"}
    return click.option("--steps", type=AT_LEAST_ONE, help="Training steps of each run.", **known)


def resolution(default: int | str = AUTO) -> Decorator:
    kind = Number(FIELDS["resolution"])
    return click.option("-r", "--resolution", default=default, show_default=True, type=kind, help="As of `wegs train`.")


def count(flag: str, default: int, what: str) -> Decorator:
    """An option that is a number of things, at least one."""
    return click.option(flag, default=default, show_default=True, type=AT_LEAST_ONE, help=what)


def seeds(default: int, what: str) -> Decorator:
    """what: each seed gives one of these."""
    return count("--seeds", default, what)


def protocol(*default: str) -> Decorator:
    kinds = click.Choice(list(PROTOCOLS))
    return click.option(
        "--protocol", "protocols", multiple=True, default=default, show_default=True, type=kinds, help="Repeatable."
    )


def output(default: str) -> Decorator:
    return click.option(
        "-o", "--output", default=Path(default), show_default=True, type=PATH, help="Folder of the runs."
    )


def settings_of(preset_name: str, steps: int | None, **changes) -> Settings:
    """The preset with these changes, and with its own steps where none are given."""
    return presets.preset(preset_name).changed(**changes, **({"steps": steps} if steps else {}))
