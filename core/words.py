"""Numbers and names in sentences."""

NAMES_SHOWN = 12


def counted(count: int, what: str) -> str:
    """`count` and its noun: 1 photo, 2 photos."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def name_them(what: str, names: list[str]) -> list[str]:
    """A note that counts and names photos, or none where there are none: "3 photos WHAT: a.jpg, b.jpg, c.jpg"."""
    return [f"{counted(len(names), 'photo')} {what}: {list_names(names)}"] if names else []


def list_names(names: list[str]) -> str:
    """The first names, and how many more there are."""
    shown = ", ".join(names[:NAMES_SHOWN])
    return shown if len(names) <= NAMES_SHOWN else f"{shown} and {len(names) - NAMES_SHOWN} more"
