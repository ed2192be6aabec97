"""Numbers, names and reasons in sentences."""

import re
from dataclasses import dataclass

NAMES_SHOWN = 12
CONTROLS = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")


def counted(count: int, what: str) -> str:
    """`count` and its noun: 1 photo, 2,000 photos."""
    return f"{count:,} {what}" if count == 1 else f"{count:,} {what}s"


def on_one_line(text: str) -> str:
    """The text with line breaks and other control characters, which names of files may hold, as their codes."""
    return CONTROLS.sub(lambda found: ascii(found[0])[1:-1], text)


@dataclass(frozen=True)
class Note:
    """A line for the user about what was found. harmless: nothing needs to be done.
    of_split: it no longer applies if no photo is held out.
    of_cameras: it is a figure of the cameras, which `wegs doctor` has a check of its own for."""

    text: str
    harmless: bool = False
    of_split: bool = False
    of_cameras: bool = False


def name_them(
    what: str, names: list[str], harmless: bool = False, of_split: bool = False, of_cameras: bool = False
) -> list[Note]:
    """A note that counts and names photos, "3 photos WHAT: a.jpg, b.jpg, c.jpg"; an empty list without photos."""
    line = f"{counted(len(names), 'photo')} {what}: {list_names(names)}"
    return [Note(line, harmless, of_split, of_cameras)] if names else []


class Reasons:
    """Collects photos by what is said of them, such as why they are not used."""

    def __init__(self) -> None:
        self._names: dict[tuple[str, bool], list[str]] = {}

    def add(self, what: str, name: str, harmless: bool = False) -> None:
        """Add the photo `name` to those of which `what` is said, in words that follow "1 photo" and "3 photos"."""
        self._names.setdefault((what, harmless), []).append(name)

    def notes(self) -> list[Note]:
        """A note for each reason, in the order in which they first came up."""
        return [note for (what, harmless), names in self._names.items() for note in name_them(what, names, harmless)]


def list_names(names: list[str]) -> str:
    """The first names, and how many more there are."""
    shown = ", ".join(names[:NAMES_SHOWN])
    return shown if len(names) <= NAMES_SHOWN else f"{shown} and {len(names) - NAMES_SHOWN} more"
