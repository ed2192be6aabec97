"""Options made from core.config: names, help, ranges, choices and defaults are written there and nowhere else."""

import os
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import Field
from pathlib import Path
from typing import Any

import click

from core.config import FIELDS, Settings, no_setting
from core.errors import BadInput, BadSetting
from core.presets import PRESETS, preset
from core.setting import AUTO, UNDECIDED, checked, wrong_kind

# Settings that have an option of their own; --set and --config reach all of them.
FLAGS = (
    "steps", "resolution", "all_photos", "max_gaussians", "sh_degree",
    "appearance", "transients", "seed", "device", "backend",
)  # fmt: skip
SHORT = {"resolution": ("-r",)}
DEFAULT_RUN = "[default: the current folder if it is a run, else the newest in runs/]"


class InputPath(click.Path):
    """A path to read. Whether it can be read is left to whoever reads it:
    click's own check would only point to the help."""

    def __init__(self):
        super().__init__(path_type=Path, readable=False)


class OutputPath(click.Path):
    """A path to write. If a `..` in it follows a folder that does not exist yet, the path is resolved; otherwise it
    would seem new although what it leads to may exist."""

    def convert(self, value, param, ctx):
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        climbed = [Path(*path.parts[:index]) for index, part in enumerate(path.parts) if part == ".."]
        return path if all(folder.exists() for folder in climbed) else Path(os.path.realpath(path))


class Number(click.ParamType):
    """The value of a setting that is a number, read and checked as `--set` does:
    click's own ranges read badly in help and errors."""

    name = "number"

    def __init__(self, item: Field):
        self.item = item

    def get_metavar(self, param, ctx=None):
        return f"[{AUTO}|N]" if self.item.metadata["auto"] else "N"

    def convert(self, value, param, ctx):
        try:
            return checked(self.item, _value_of(self.item, value))
        except BadSetting as problem:
            self.fail(str(problem), param, ctx)


class WithSettings(click.Command):
    """A command whose help ends with the list of all settings, in sections."""

    def format_epilog(self, ctx, formatter):
        formatter.write_paragraph()
        formatter.write_text("Settings for --set KEY=VALUE and --config, with their defaults:")
        for section, rows in settings_by_section().items():
            with formatter.section(section):
                formatter.write_dl(rows, col_max=34)  # none is wider


def setting_option(name: str) -> Callable:
    """A click option for the field `name` of Settings: None unless typed, so that a preset can apply."""
    item = FIELDS[name]
    rules = item.metadata
    flags = *SHORT.get(name, ()), _option_of(name)
    if item.type is bool:
        return click.option(*flags, name, is_flag=True, default=None, help=rules["help"])
    kind = click.Choice(rules["choices"]) if rules["choices"] else Number(item)
    return click.option(
        *flags, name, type=kind, default=None, help=f"{rules['help']}  [default: {shown_default(name)}]"
    )


def _option_of(name: str) -> str:
    return "--" + name.replace("_", "-")


def shown_default(name: str) -> Any:
    """The default of a setting as one would type it."""
    item = FIELDS[name]
    return AUTO if item.metadata["auto"] and item.default == UNDECIDED else item.default


def settings_options(command: Callable) -> Callable:
    """--preset, the options of FLAGS, --config and --set; `settings_from` takes their values."""
    decorators = [
        click.option(
            "--preset",
            "preset_name",
            type=click.Choice(list(PRESETS)),
            help="Settings to start from; other options override them. "
            f"quick: a first try, of {PRESETS['quick']['steps']:,} steps. paper: to compare with the paper, "
            "whose sizes want a GPU. vanilla: plain 3DGS, without looks and masks.  [default: default]",
        ),
        *map(setting_option, FLAGS),
        click.option(
            "--config",
            type=InputPath(),
            help='TOML file with lines such as `steps = 2000` or `preset = "quick"`; the command line overrides it.',
        ),
        click.option(
            "--set",
            "assignments",
            multiple=True,
            metavar="KEY=VALUE",
            help="Change a setting of the list below; repeatable.",
        ),
    ]
    for decorate in reversed(decorators):
        command = decorate(command)
    return command


def settings_from(
    preset_name: str | None, config: Path | None, assignments: tuple[str, ...], typed: dict[str, Any]
) -> Settings:
    """Settings: command line beats file beats preset beats default. typed: options, None where not typed.
    The file may name a preset."""
    written = {} if config is None else _read_toml(config)
    _no_options_among(written.keys() - {"preset"}, f"{config}: ")
    _no_options_among(assignment.partition("=")[0].strip() for assignment in assignments)
    values = {name: value for name, value in {"preset": preset_name, **typed}.items() if value is not None}
    for assignment in assignments:
        name, value = _parse(assignment)
        if name in values:
            raise BadSetting(f"{name} is given twice on the command line.", "Give it once.")
        values[name] = value
    chosen = {"preset": "default", **written, **values}
    try:
        return preset(str(chosen.pop("preset"))).changed(**chosen)
    except BadSetting as problem:
        if set(problem.names) & (written.keys() - values.keys()):
            raise BadSetting(f"{config}: {problem.what}", problem.fix) from None
        raise


def _no_options_among(names: Iterable[str], where: str = "") -> None:
    """Raise BadSetting for names of the current command's options that are no settings.
    where: the file that has them, before a message."""
    context = click.get_current_context(silent=True)
    given = [param for param in context.command.params if isinstance(param, click.Option)] if context else []
    options = {option.opts[-1].removeprefix("--"): option for option in given if option.name not in FIELDS}
    for name in names:
        if name in options:
            value = "" if options[name].is_flag else " ..."
            raise BadSetting(
                f"{where}{name} is no setting but an option of the command line.", f"Type: --{name}{value}"
            )


def settings_by_section() -> dict[str, list[tuple[str, str]]]:
    """By section, each setting with its default, and its help; of one that has an option, the help stands there."""
    sections: dict[str, list[tuple[str, str]]] = {}
    for name, item in FIELDS.items():
        if item.metadata["section"]:
            rows = sections.setdefault(item.metadata["section"], [])
        choices = f"  [{'|'.join(item.metadata['choices'])}]" if item.metadata["choices"] else ""
        text = f"See {_option_of(name)}." if name in FLAGS else item.metadata["help"] + choices
        rows.append((f"{name} = {str(shown_default(name)).lower()}", text))
    return sections


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as problem:
        raise BadInput(f"{path} cannot be read: {problem.strerror}.", "Give a TOML file to --config.") from None
    except ValueError as problem:  # TOML's own errors and text that is not UTF-8
        raise BadInput(f"{path} is not TOML: {problem}.", "Write lines such as: steps = 2000") from None
    if table := next((name for name, value in values.items() if isinstance(value, dict)), None):
        raise BadSetting(
            f"{path}: {table} is a table, and settings stand in none.",
            f"Remove the line [{table}], and keep those below it.",
        )
    return values


def _parse(assignment: str) -> tuple[str, Any]:
    """Name and value of a KEY=VALUE."""
    name, _, text = map(str.strip, assignment.partition("="))
    name = name.replace("-", "_")
    if not name or not text:
        raise BadSetting(f"--set {assignment} gives no {'value' if name else 'setting'}.", "Type: --set key=value")
    if name not in FIELDS:
        raise no_setting(name)
    return name, _value_of(FIELDS[name], text)


def _value_of(item: Field, text: str) -> Any:
    """The text as a value of the Settings field `item`; AUTO where that is allowed."""
    if item.metadata["auto"] and text == AUTO:
        return AUTO
    kind: Any = item.type
    try:
        return click.BOOL(text) if kind is bool else kind(text)
    except (ValueError, click.BadParameter):
        raise wrong_kind(item, text) from None
