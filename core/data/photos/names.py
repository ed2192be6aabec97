"""Names of photos: what else a photo may be called, which row of a list means it, and file paths made of it."""

import os
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from unicodedata import normalize

from core.data.photos.folder import SUFFIXES


def names_without_suffixes(name: str) -> list[str]:
    """What a photo may be called: its name, its name without the suffix, and,
    as structure from motion makes a.png.jpg of a.png, without both."""
    stem = without_suffix(name)
    return [name, stem, *([without_suffix(stem)] if Path(stem).suffix.lower() in SUFFIXES else [])]


def composed(name: str) -> str:
    """The name in Unicode form NFC, é as one character: macOS may write two, which nobody types."""
    return normalize("NFC", name)


def folded(name: str) -> str:
    """The name `composed` and without regard to case, for comparison."""
    return composed(name).casefold()


def without_suffix(name: str) -> str:
    """The name of a photo, which may be a path, without its suffix."""
    return name[: len(name) - len(Path(name).suffix)]


def rows_that_mean(names: Iterable[str], listed: set[str]) -> tuple[dict[str, str], dict[str, list[str]]]:
    """For each photo that a list names, the row that means it; and each row that fits several photos, with these.

    A row means a photo if it is the photo's name or the end of its path, with or without the suffix, or if it is the
    only longer path that ends in the photo's name. The rows and photos that remain are then compared without regard to
    case.
    """
    names = set(names)
    rows, unclear = _rows_spelt_alike(names, listed, composed)
    left = listed - set(rows.values()) - unclear.keys()
    more, still_unclear = _rows_spelt_alike(names - rows.keys(), left, folded)
    return rows | more, unclear | still_unclear


def _rows_spelt_alike(
    names: Iterable[str], listed: set[str], spelt: Callable[[str], str]
) -> tuple[dict[str, str], dict[str, list[str]]]:
    """As `rows_that_mean`, where names are equal if `spelt` makes the same of them."""
    exact = {spelt(row): row for row in sorted(listed)}
    longer: dict[str, list[str]] = {}
    for form, row in exact.items():
        for end in _ends(form.replace("\\", "/")):  # some were written on Windows
            if end != form:
                longer.setdefault(end, []).append(row)
    fitting: dict[str, list[str]] = {}
    for name in sorted(names):
        shorter = [exact[end] for whole in names_without_suffixes(spelt(name)) for end in _ends(whole) if end in exact]
        meant = shorter[:1] or longer.get(spelt(name), [])
        if len(meant) == 1:
            fitting.setdefault(meant[0], []).append(name)
    rows, unclear = {}, {}
    for row, those in fitting.items():
        form = spelt(row)
        exactly = (
            [name for name in those if spelt(name) == form]
            or [name for name in those if spelt(without_suffix(name)) == form]
            or those
        )
        if len(exactly) == 1:
            rows[exactly[0]] = row
        else:
            unclear[row] = those
    return rows, unclear


def _ends(name: str) -> list[str]:
    """The name, then the name without its outermost folder, without the next one, and so on."""
    parts = name.split("/")
    return ["/".join(parts[number:]) for number in range(len(parts))]


def is_file(path: Path | str) -> bool:
    """Whether there is a file; False, and no error as from pathlib, for a name that is too long for the disk."""
    return os.path.isfile(path)


def relative_path(name: str) -> Path:
    """A photo's name as a path that stays inside the folder that it is joined to:
    some models name photos by whole paths, or with `..`.

    Of an absolute path only the file name is kept; on Windows, also of one with only a drive or a root, which would
    replace the folder.
    """
    path = Path(name.replace("\\", "/"))  # some were written on Windows
    return Path(path.name) if path.anchor else Path(*(part for part in path.parts if part != ".."))


def png_paths(names: Iterable[str]) -> dict[str, Path]:
    """A PNG's relative path for each of these photos, no two alike: a/0001.png for a/0001.jpg, or a/0001.jpg.png where
    there is an a/0001.webp as well; numbered where that is not enough."""
    paths = {name: relative_path(name) for name in names}
    sharing = Counter(path.with_suffix(".png") for path in paths.values())
    taken: dict[Path, str] = {}
    for name, path in paths.items():
        png, number = path.with_suffix(".png"), 1
        if sharing[png] > 1:
            png = path.with_name(f"{path.name}.png")
        while png in taken:  # as photos named by whole paths may be
            number += 1
            png = path.with_name(f"{path.name}-{number}.png")
        taken[png] = name
    return {name: png for png, name in taken.items()}
