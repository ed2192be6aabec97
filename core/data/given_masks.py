"""Masks that come with photos, from the user (`wegs train --masks DIR`) or from the scene:
which photo each belongs to, and whether it fits."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import log
from pathlib import Path

from core.data.collection import Collection, GivenMask, Photo
from core.data.photos.file import named_with_fault, probe
from core.data.photos.folder import SUFFIXES, list_photos
from core.data.photos.names import composed, is_file, names_without_suffixes, relative_path
from core.data.photos.pixels import read_mask
from core.data.sfm.originals import lenses_of
from core.errors import BadInput
from core.scene.lens import Lens
from core.words import Note, Reasons, counted

TRIED = 3  # masks that are read at the start, to notice if photos were given in their place
SHAPE_TOLERANCE = 0.05  # by which the aspect of a mask may differ from its picture's
USED_WHOLE = ", used whole"  # what becomes of a photo whose mask is of no use, unless that is an error


def check_masks(folder: Path, photos: Sequence[str]) -> None:
    """Raise BadInput unless the folder is there and holds masks of the photos:
    asked before cameras are found, which may take minutes.

    photos: the names of plain photos; none if they are not known yet.
    """
    fix = "Give --masks a folder with one mask a photo."
    if not folder.is_dir():
        raise BadInput(
            f"{folder} is a file, not a folder." if folder.exists() else f"There is no folder {folder}.", fix
        )
    os.listdir(folder)  # raises if it may not be read; rglob would find nothing
    if not any(path.suffix.lower() in SUFFIXES for path in folder.rglob("*")):
        raise BadInput(f"{folder} holds no pictures.", fix)
    if photos:
        masks = _masks_of(photos, {Path(): _by_stem(folder)})
        if not masks:
            raise _none_fits(folder, photos[0])
        _check_usable(list(masks.values())[:TRIED])


def _masks_of(photos: Sequence[str], listed: Mapping[Path, dict[str, list[Path]]]) -> dict[str, Path]:
    """The mask of each of the photos, by name, that has one. listed: `_by_stem` of each folder, relative to that of the
    masks. Raises BadInput for two masks of one photo."""
    called = {relative_path(each) for name in photos for each in names_without_suffixes(composed(name))}
    masks = {}
    for photo in photos:
        name = relative_path(composed(photo))
        stems = names_without_suffixes(name.name)  # the first one found counts
        folders = listed[relative_path(photo).parent], listed[Path()]
        fitting = next((found[stem] for found in folders for stem in stems if stem in found), [])
        if len(fitting) > 1 and all(name.with_name(composed(mask.name)) in called for mask in fitting):
            # Of photos whose names differ in the suffix alone.
            fitting = [mask for mask in fitting if composed(mask.name) in stems]
        if len(fitting) > 1:
            raise BadInput(f"{fitting[0]} and {fitting[1].name} are masks of one photo.", "Remove one of them.")
        if fitting:
            masks[photo] = fitting[0]
    return masks


def _check_usable(masks: Sequence[Path]) -> None:
    """Raise the first one's BadInput if none of them can be read as a mask."""
    problems = []
    for mask in masks:
        try:
            read_mask(mask, (1, 1))
        except BadInput as problem:
            problems.append(problem)
    if len(problems) == len(masks):
        raise problems[0]


def _none_fits(folder: Path, photo: str) -> BadInput:
    return BadInput(
        f"{folder} holds no mask of a training photo.",
        f"Name masks as photos, such as {relative_path(photo).with_suffix('.png')}.",
    )


def with_masks_in(collection: Collection, folder: Path) -> Collection:
    """The collection whose photos have the masks in `folder`; white = use, of any format and size.

    A mask is named after its photo: `0001.png` or, as for COLMAP, `0001.jpg.png` belongs to `0001.jpg`. For photos in
    subfolders (`left/0001.jpg`) a mask in the same subfolder beats one in `folder` itself. A photo without a mask here
    is used whole, even if the scene gives it one. Notes: as `with_masks_by_name`, and which masks belong to no photo.
    Raises BadInput for a folder without a usable mask, for two masks of one photo, and for one of two training photos.
    """
    listed = {
        path: _by_stem(folder / path)
        for path in {Path(), *(relative_path(photo.name).parent for photo in collection.photos)}
    }
    masks = _masks_of([photo.name for photo in collection.photos], listed)
    unused = sorted(
        {path for found in listed.values() for paths in found.values() for path in paths} - set(masks.values())
    )
    training = collection.split("train")
    _check_not_shared({photo.name: masks[photo.name] for photo in training if photo.name in masks})
    if not any(photo.name in masks for photo in training):
        raise _none_fits(folder, training[0].name)
    found = with_masks_by_name(collection, masks, folder)
    if not any(photo.mask for photo in found.split("train")):
        why = "; ".join(note.text for note in found.notes[len(collection.notes) :] if not note.harmless)
        raise BadInput(
            f"No mask in {folder} can be used: {why.replace(USED_WHOLE, '')}.",
            "Copy them again, or draw them on the whole photos, as displayed.",
        )
    _check_usable([photo.mask.path for photo in found.split("train") if photo.mask][:TRIED])
    notes = []
    if any(photo.mask for photo in collection.photos):
        notes.append(Note("The masks that the scene itself gives are not used."))
    if unused:
        notes.append(
            Note(f"{counted(len(unused), 'mask')} of no photo in use, such as {unused[0].relative_to(folder)}.")
        )
    return replace(found, notes=(*found.notes, *notes))


def _check_not_shared(masks: dict[str, Path]) -> None:
    """Raise BadInput if one mask fits several photos,
    whose names differ only in folder or suffix. masks: by photo name."""
    photo_of: dict[Path, str] = {}
    for photo, mask in masks.items():
        if (other := photo_of.setdefault(mask, photo)) != photo:
            fix = f"Name each mask as its photo, in a folder as the photo's, such as {relative_path(other)}.png."
            raise BadInput(f"{mask} may be the mask of {other} or of {photo}.", fix)


def with_mask(photo: Photo, mask: Path, size: tuple[int, int], taken_through: Lens | None) -> Photo:
    """The photo with its mask, which has this `size`. taken_through: the original's lens, if the photo's file is an
    undistorted copy; the mask is then taken to be drawn on the original, unless it has the size of the copy."""
    of_copy = size == (photo.camera.width, photo.camera.height)
    return replace(photo, mask=GivenMask(mask, None if of_copy else taken_through))


def size_for_mask(photo: Photo) -> tuple[int, int]:
    """The size of the picture that a mask of the photo is drawn on:
    the photo, or the original that it is an undistorted copy of."""
    lens = None if photo.mask is None else photo.mask.lens
    return (photo.camera.width, photo.camera.height) if lens is None else (lens.width, lens.height)


def fits(size: tuple[int, int], wanted: tuple[int, int]) -> bool:
    """Whether a mask of this `size` has the aspect of its picture, of the size `wanted`,
    within what drawing by hand may change."""
    (width, height), (wanted_width, wanted_height) = size, wanted
    return abs(log(width * wanted_height / (height * wanted_width))) <= SHAPE_TOLERANCE + 1 / min(size)


def check_fits(mask: Path, size: tuple[int, int], wanted: tuple[int, int]) -> None:
    """Raise BadInput unless a mask of this `size` `fits` its picture."""
    if not fits(size, wanted):
        shapes = f"{size[0]} x {size[1]} px, its photo {wanted[0]} x {wanted[1]}"
        raise BadInput(f"The mask {mask} is {shapes}: of another shape.", "Give one of the whole photo, as displayed.")


def with_masks_by_name(collection: Collection, masks: dict[str, Path], source: Path) -> Collection:
    """The collection whose photos have these `masks`, by photo name, in place of any others. source: what named them.

    Notes say how many training photos have one; which have none; whose mask has another size and is resized (nearest
    pixel); and whose mask is not used, because it is missing, damaged or of another shape.
    """
    lenses, photos, said = lenses_of(collection.root), [], Reasons()
    for photo in collection.photos:
        heard = said if photo.split == "train" else Reasons()  # masks never enter a figure
        photos.append(_with_mask_if_usable(photo, masks.get(photo.name), lenses.get(photo.name), heard))
    count = sum(photo.mask is not None for photo in photos if photo.split == "train")
    summary = [Note(f"{counted(count, 'photo')} with a mask from {source}.", harmless=True)] if count else []
    return replace(collection, photos=tuple(photos), notes=(*collection.notes, *summary, *said.notes()))


def _with_mask_if_usable(photo: Photo, mask: Path | None, taken_through: Lens | None, said: Reasons) -> Photo:
    """The photo with its mask, or without one if the mask cannot be used; what is odd about it goes into `said`."""
    whole = replace(photo, mask=None)
    if mask is None:
        said.add(f"without a mask{USED_WHOLE}", photo.name)
        return whole
    if not is_file(mask):
        said.add(f"whose mask is missing{USED_WHOLE}", f"{photo.name} ({mask})")
        return whole
    try:
        size = probe(mask).displayed
    except BadInput as problem:
        said.add(f"with a damaged mask{USED_WHOLE}", named_with_fault(photo.name, mask, problem))
        return whole
    found = with_mask(photo, mask, size, taken_through)
    wanted = size_for_mask(found)
    if not fits(size, wanted):
        turned, other = f"on its side{USED_WHOLE} (turn it as EXIF turns the photo)", f"of another shape{USED_WHOLE}"
        said.add(f"with a mask {turned if fits(size[::-1], wanted) else other}", photo.name)
        return whole
    if size != wanted:
        said.add("with a mask of another size, which is resized", photo.name)
    return found


def with_same_masks(collection: Collection, before: Collection) -> Collection:
    """The collection with the masks that it had when it was read `before`, so that a run can go on.
    BadInput if one of a training photo is gone."""
    then = {photo.name: photo.mask for photo in before.photos}
    if gone := [photo.mask.path for photo in before.split("train") if photo.mask and not photo.mask.path.is_file()]:
        raise BadInput(f"{counted(len(gone), 'mask')} of the run cannot be found, such as {gone[0]}.", "Put them back.")
    return replace(collection, photos=tuple(replace(photo, mask=then.get(photo.name)) for photo in collection.photos))


def _by_stem(folder: Path) -> dict[str, list[Path]]:
    """The pictures in a folder by their stems, `composed`; empty if there is no such folder."""
    found: dict[str, list[Path]] = {}
    if not folder.is_dir():
        return found
    for path in list_photos(folder):
        found.setdefault(composed(path.stem), []).append(path)
    return found
