"""Names of photos: what else one may be called, whether there is such a file, and where one of that name goes."""

import os
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from core.data.photos.folder import SUFFIXES


def names_without_suffixes(name: str) -> list[str]:
    """What a photo may be called: its name, without its suffix, and, where structure from motion made a.png.jpg of a.png, without both."""
    stem = without_suffix(name)
    return [name, stem, *([without_suffix(stem)] if Path(stem).suffix.lower() in SUFFIXES else [])]


def without_suffix(name: str) -> str:
    """The name of a photo, which may be a path, without its suffix."""
    return name[: len(name) - len(Path(name).suffix)]


def is_file(path: Path | str) -> bool:
    """Whether there is a file; False, where pathlib raises, for a name that is too long for the disk."""
    return os.path.isfile(path)


def relative_path(name: str) -> Path:
    """A photo's name as a path that cannot leave the folder it is joined to: some models name photos by whole paths, or through `..`."""
    path = Path(name)
    return Path(path.name) if path.is_absolute() else Path(*(part for part in path.parts if part != ".."))


def png_paths(names: Iterable[str]) -> dict[str, Path]:
    """A PNG's relative path for each of these photos, no two alike: a/0001.png for a/0001.jpg, or a/0001.jpg.png where there is an
    a/0001.webp as well; numbered where that is not enough."""
    paths = {name: relative_path(name) for name in names}
    sharing = Counter(path.with_suffix(".png") for path in paths.values())
    taken: dict[Path, str] = {}
    for name, path in paths.items():
        png, number = path.with_suffix(".png"), 1
        if sharing[png] > 1:
            png = path.with_name(f"{path.name}.png")
        while png in taken:  # named by whole paths, or through `..`
            number += 1
            png = path.with_name(f"{path.name}-{number}.png")
        taken[png] = name
    return {name: png for png, name in taken.items()}
