"""One setting: what it accepts, and what is said of a value that it does not accept."""

import sys
from dataclasses import Field, field
from typing import Any

from core.errors import BadSetting

AUTO = "auto"  # decided before training: config.DECIDABLE by core.training.decisions, others where they are used
UNDECIDED = -1  # the same, for a setting that is a number
KINDS: dict[Any, str] = {int: "a whole number", float: "a finite number", bool: "true or false", str: "a word"}


def setting(
    default: Any,
    help: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple = (),
    auto: bool = False,
    section: str = "",
) -> Any:
    """A field of Settings: its default, its help, and the values it accepts.

    auto: a number may be UNDECIDED as well. section: the heading, in lists of settings, of this one and those that
    follow.
    """
    rules = {"help": help, "low": low, "high": high, "choices": choices, "auto": auto, "section": section}
    return field(default=default, metadata=rules)


def accepted(item: Field) -> str:
    """What to give for the Settings field `item`, in a sentence."""
    rules = item.metadata
    if choices := ("true", "false") if item.type is bool else rules["choices"]:
        return f"Choose one of: {', '.join(choices)}."
    span = f"of at least {rules['low']}" if rules["high"] is None else f"from {rules['low']} to {rules['high']}"
    return f"Give one {span}{f', or {AUTO}' if rules['auto'] else ''}."


def wrong_kind(item: Field, text: str) -> BadSetting:
    """The error for a value of another type than the Settings field `item` has, written as `text`."""
    return BadSetting(f"{item.name}={text} is not {KINDS[item.type]}.", accepted(item), (item.name,))


def checked(item: Field, value: Any) -> Any:
    """`value`, as a float where the Settings field `item` is one: whole numbers are taken for it;
    UNDECIDED for AUTO, where that is allowed. BadSetting for another type or beyond its range."""
    rules = item.metadata
    if rules["auto"] and value in (AUTO, UNDECIDED):
        return UNDECIDED
    kind: Any = item.type  # a class: Settings does not postpone its annotations
    good = isinstance(value, kind) and not (kind is int and isinstance(value, bool))
    if kind is float:
        good = isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= sys.float_info.max
    if not good:
        raise wrong_kind(item, repr(value))
    if rules["choices"] and value not in rules["choices"]:
        fault = "not a choice"
    elif rules["low"] is not None and value < rules["low"]:
        fault = "too small"
    elif rules["high"] is not None and value > rules["high"]:
        fault = "too large"
    else:
        return kind(value)
    raise BadSetting(f"{item.name}={value!r} is {fault}.", accepted(item), (item.name,))
