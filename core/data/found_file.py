"""Finds photos whose file names differ slightly from those in a model, as programs, systems and disks change names."""

import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from core.data.photos.folder import SUFFIXES, list_photos
from core.data.photos.names import folded, is_file, relative_path
from core.data.posed import PosedPhoto
from core.words import Note, name_them

SHRUNKEN = ("images_2", "images_4", "images_8")  # copies that the original project, nerfstudio and data sets keep


def with_files_found(photos: Sequence[PosedPhoto], folders: Iterable[Path]) -> tuple[list[PosedPhoto], list[Note]]:
    """The photos, with each missing file replaced by one of nearly the same name, if there is one;
    and a note that names these.

    folders: searched after the photo's own folder, first in the subfolder that the photo's name has.
    """
    missing = [photo for photo in photos if not is_file(photo.path)]
    there = {photo.path for photo in photos} - {photo.path for photo in missing}
    folders = tuple(folders)
    places = {
        photo.path: [folder / below for folder in folders for below in (relative_path(photo.name).parent, ".")]
        for photo in missing
    }
    found = nearly_named(places, there)
    names = [
        f"{photo.name} ({named_beside(found[photo.path], photo.path)})" for photo in missing if photo.path in found
    ]
    notes = name_them("found under another name or in another folder", names, harmless=True)
    return [replace(photo, path=found.get(photo.path, photo.path)) for photo in photos], notes


def named_beside(path: Path, missing: Path) -> str:
    """The name of the file; if it lies in another folder,
    with as many of its folders as it takes to tell the two apart."""
    if path.parent == missing.parent:
        return path.name
    shown = path.name
    for folder, expected in zip(path.parents, missing.parents, strict=False):
        shown = f"{folder.name}/{shown}"
        if folder.name != expected.name:
            break
    return shown


def nearly_named(places: Mapping[Path, Iterable[Path]], others: Iterable[Path] = ()) -> dict[Path, Path]:
    """For each of these missing files, the photo that it must be; files with no such photo, or several, are left out.

    The photo's name may differ in case, Unicode form and suffix. The file's own folder is searched first, then its
    `places`. A photo that would stand for several missing files, or that is one of the `others`, is not taken.
    """
    known, found = {}, {}
    for path, folders in places.items():
        name = folded(path.name.replace("\\", "/").rsplit("/", 1)[-1])  # some were written on Windows
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
    """The photos in a folder by name and by stem; empty if there is no such folder."""
    photos: dict[str, list[Path]] = {}
    if not os.path.isdir(folder):
        return photos
    for photo in list_photos(folder):
        for name in (photo.name, photo.stem):
            photos.setdefault(folded(name), []).append(photo)
    return photos
