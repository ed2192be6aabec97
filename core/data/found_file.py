"""Photos that lie under names which are nearly those that a model gives: other programs, systems and disks change them."""

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from unicodedata import normalize

from core.data.photo_folder import SUFFIXES, list_photos
from core.data.placing import View
from core.words import Note, name_them


def with_files_found(views: Sequence[View], folders: Iterable[Path]) -> tuple[list[View], list[Note]]:
    """The views, those whose file is missing with one of nearly its name, and a note on these.

    folders: where else to look than in the folder that is said.
    """
    missing = [view for view in views if not os.path.isfile(view.path)]  # pathlib's raises for names that are too long
    if not missing:
        return list(views), []
    there = {view.path for view in views} - {view.path for view in missing}
    found = nearly_named([view.path for view in missing], folders, there)
    names = [f"{view.name} ({found[view.path].name})" for view in missing if view.path in found]
    notes = name_them("found under another name or in another folder", names, harmless=True)
    return [replace(view, path=found.get(view.path, view.path)) for view in views], notes


def nearly_named(paths: Iterable[Path], folders: Iterable[Path], others: Iterable[Path] = ()) -> dict[Path, Path]:
    """The photos that these paths of missing files can only mean, where there is one: in the folder that is said or else in `folders`
    the only one that differs in nothing but capitals, the form of its Unicode or its suffix, if it is none of the `others`."""
    folders, known, found = tuple(folders), {}, {}
    for path in paths:
        name = _key(path.name.replace("\\", "/").rsplit("/", 1)[-1])  # some were written on Windows
        stem, suffix = os.path.splitext(name)
        for folder in (path.parent, *folders):
            if folder not in known:
                known[folder] = _by_key(folder)
            alike = known[folder].get(name) or (known[folder].get(stem) if suffix in SUFFIXES else None)
            if alike and len(alike) == 1:
                found[path] = alike[0]
                break
    times = Counter([*found.values(), *others])
    return {path: photo for path, photo in found.items() if times[photo] == 1}


def _by_key(folder: Path) -> dict[str, list[Path]]:
    """The photos of the folder by their names and by their stems; none where there is no such folder."""
    photos: dict[str, list[Path]] = {}
    for photo in list_photos(folder) if os.path.isdir(folder) else ():
        for name in (photo.name, photo.stem):
            photos.setdefault(_key(name), []).append(photo)
    return photos


def _key(name: str) -> str:
    return normalize("NFC", name).casefold()
