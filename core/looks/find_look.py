"""Finds the look that the user names: `neutral`, a saved look, a photo file,
or a photo of the collection by its name."""

import difflib
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch

from core.appearance.colouring import Colouring
from core.data.collection import Collection, Photo
from core.data.given_masks import check_fits, size_for_mask, with_mask
from core.data.photos.file import probe
from core.data.photos.names import is_file
from core.data.photos.pixels import mask_size, read_light
from core.data.sfm import originals
from core.errors import BadInput, command
from core.looks import saved_look
from core.looks.outside import light_in_words, read_from_outside
from core.looks.refined_look import not_refined, refined_of_collection, refined_outside
from core.looks.trained import NEUTRAL, Look, TrainedRun, neutral_look
from core.report import QUIET, Report
from core.run.sized_photo import SizedPhoto

SMALLEST_PHOTO_PX = 16  # of the shorter side; in a smaller photo, light could not be told from noise


@torch.no_grad()
def find_look(
    trained: TrainedRun, appearance: str, mask: Path | None = None, refine: bool = True, report: Report = QUIET
) -> Look:
    """The look that `appearance` names.

    mask: a picture, white where the photo is to be used; what it hides does not affect the look at all. refine: refine
    the look of a photo whose camera is known or can be found; this takes seconds, with progress in `report`.

    Tried in this order: `neutral`; the path of a saved look's .json; the path of a photo, which may be in the
    collection, or the original of one that is; the name of a look saved in the run; the name of a photo of the
    collection, also without its suffix if that is unambiguous. A training photo has the embedding that was learned for
    it; a held-out one, or one with `mask`, is encoded with its predicted mask, any other photo with M := 1.
    Raises BadInput, with the nearest name, if nothing fits; and for a mask that is no file, or given for a look that is
    not read from a photo.
    """
    if mask is not None and not mask.is_file():  # a pipe would be waited for without end
        raise BadInput(
            f"{mask} is not a file." if mask.exists() else f"There is no mask {mask}.", "Give a picture, white = use."
        )
    saved = _saved_as(trained, appearance)
    if mask is not None and (appearance == NEUTRAL or saved or not trained.settings.encodes_photos):
        raise BadInput(
            f"The look {appearance} is not read from a photo that {mask} could hide a part of.", "Leave --mask out."
        )
    if appearance == NEUTRAL:
        return neutral_look(trained)
    if saved:
        like = Colouring(trained.model.mean_embedding, changes=trained.given_spread | trained.model.hidden_weights)
        look = saved_look.load(saved, trained.identity, trained.step, like)
        return replace(look, colouring=look.colouring.to(trained.device))
    photo = _of_collection(trained, appearance)
    if photo is not None:
        look = look_of_photo(trained, photo, mask, refine, report)
        if photo.path not in [known.path for known in trained.collection.photos]:
            look = replace(look, source=f"{look.source} (whose file is gone; this one has its name and size)")
        return look
    if Path(appearance).is_file():
        look = look_of_file(trained, Path(appearance), mask)
        return refined_outside(trained, look, Path(appearance), mask, report) if refine else look
    raise _unknown(trained, appearance)


def _saved_as(trained: TrainedRun, appearance: str) -> Path | None:
    """The file of the saved look that `appearance` means by path or name, or None.
    A .json that does not exist is reported when it is read."""
    path = Path(appearance)
    named = path if path.name != appearance else saved_look.file_of(trained.folder, appearance)
    if path.suffix == ".json":
        return path if path.is_file() else named
    # The name of a photo may be as long as a name can be.
    return named if not path.is_file() and is_file(named) else None


def _of_collection(trained: TrainedRun, name: str) -> Photo | None:
    """The photo of the collection that `name` means:
    by its file, by the original that the file was made of, by a file that was moved, or by name."""
    path, collection = Path(name), trained.collection
    if not path.is_file():
        return collection.called(name)
    same = next((photo for photo in collection.photos if photo.path.is_file() and photo.path.samefile(path)), None)
    made_of = originals.name_in(collection.root, path)
    return (
        same or next((photo for photo in collection.photos if photo.name == made_of), None) or _moved(collection, path)
    )


def _moved(collection: Collection, path: Path) -> Photo | None:
    """The photo of the collection whose file is gone, and which has the name and size of this file."""
    photo = collection.called(path.name)
    if photo is None or photo.path.is_file():
        return None
    with suppress(BadInput):  # for a file that is no photo, which is reported where it is read
        if probe(path).displayed == (photo.camera.width, photo.camera.height):
            return replace(photo, path=path)
    return None


def find_view(trained: TrainedRun, name: str | None) -> Photo:
    """The photo of the collection that `name` means, as in `find_look`;
    for None the first held-out one, or the first of all.

    Raises BadInput if there is none.
    """
    if name is not None:
        if photo := _of_collection(trained, name):
            return photo
        if lost := _left_out(trained, name):
            raise BadInput(
                f"{lost.name} was left out when the cameras were found.",
                f"Choose another, such as {trained.collection.photos[0].name}.",
            )
    return trained.collection.photo(name)


def _left_out(trained: TrainedRun, name: str) -> Path | None:
    """The file called `name`, with or without suffix, that structure from motion left out of the scene."""
    return next(
        (path for path in originals.left_out(trained.collection.root) if Path(name).name in (path.name, path.stem)),
        None,
    )


def look_of_photo(
    trained: TrainedRun, photo: Photo, mask: Path | None = None, refine: bool = True, report: Report = QUIET
) -> Look:
    """The look of a photo of the collection; the rest as in `find_look`."""
    kind = "training" if photo.split == "train" else "held-out"
    named = partial(Look, Path(photo.name).stem, f"{kind} photo {photo.name}")
    if not trained.has_looks:
        return named(neutral_look(trained).colouring)
    row = trained.model.row_of(photo.name)
    if row is None:
        _refuse_unknown_to_table(trained, photo.name)
    if row is None or mask is not None or trained.photo_embeddings is None:
        sized = _sized(trained, photo, mask, report)
        look = named(Colouring(trained.model.read(sized.encoder_input, row).embedding))
        return refined_of_collection(trained, look, sized, report) if refine else look
    learned = named(Colouring(trained.photo_embeddings[row]))
    if not refine:
        return learned
    try:
        sized = trained.sized_photo(photo)
    except BadInput as problem:
        return not_refined(learned, problem.what)
    return refined_of_collection(trained, learned, sized, report)


def _sized(trained: TrainedRun, photo: Photo, mask: Path | None, report: Report) -> SizedPhoto:
    """The photo to read: with the user's mask if there is one, else with its own,
    or without that if it cannot be used."""
    if mask is not None:
        return trained.sized_photo(_masked_by_user(trained, photo, mask))
    try:
        return trained.sized_photo(photo)
    except BadInput as problem:
        whole = trained.sized_photo(replace(photo, mask=None))  # raises the same where that was not the mask's fault
        report.warn(f"{problem.what} {photo.name} is read without its mask.")
        return whole


def _masked_by_user(trained: TrainedRun, photo: Photo, mask: Path) -> Photo:
    """The photo with this mask in place of its own; BadInput unless the mask fits."""
    size = mask_size(mask)
    masked = with_mask(photo, mask, size, originals.lenses_of(trained.collection.root).get(photo.name))
    check_fits(mask, size, size_for_mask(masked))
    return masked


def look_of_file(trained: TrainedRun, path: Path, mask: Path | None = None) -> Look:
    """The look of a photo file as one from outside the collection, not refined; the rest as in `find_look`."""
    _refuse_unknown_to_table(trained, str(path))
    if mask is not None:
        check_fits(mask, mask_size(mask), probe(path).displayed)
    pixels = read_light(path, mask)
    height, width = pixels.shape[:2]
    if min(height, width) < SMALLEST_PHOTO_PX:
        raise BadInput(f"{path} is {width} x {height} px, too small to show a look.", "Use a larger photo.")
    picture = torch.from_numpy(pixels).to(trained.device).permute(2, 0, 1).float().div_(255)
    read = read_from_outside(trained, picture)
    source = f"photo {path.name} from outside the collection"
    if read.tone is not None and (light := light_in_words(read.tone)):
        source += f", lit unlike any photo of the place ({light})"
    return Look(path.stem, source, read)


def _refuse_unknown_to_table(trained: TrainedRun, name: str) -> None:
    if trained.model.embedding_table is not None:
        raise BadInput(
            f"{name} is not a training photo, and a run with embedding=glo knows no other looks.",
            "Name a training photo, or train with embedding=encoder.",
        )


def _unknown(trained: TrainedRun, appearance: str) -> BadInput:
    if not appearance.strip():
        return BadInput("The look has no name.", f"Give a photo, or {NEUTRAL}.")
    if Path(appearance).is_dir():
        return BadInput(f"{appearance} is a folder, not a photo.", "Give one of its photos.")
    if lost := _left_out(trained, appearance):
        path = str(lost) if lost.is_file() else f"no longer {lost}"
        return BadInput(
            f"{lost.name} was left out when the cameras were found.",
            f"Give its path, as of a photo from outside: {path}",
        )
    trained.collection.check_unambiguous(appearance)
    photos = [photo.name for photo in trained.collection.photos]
    names = {name.lower(): name for name in (*photos, *saved_look.names(trained.folder))}
    near = [names[name] for name in difflib.get_close_matches(appearance.lower(), names, n=1, cutoff=0.0)] or [NEUTRAL]
    return BadInput(
        f"{appearance} is neither a photo file, nor a photo or saved look of {trained.folder}.",
        f"Give a path, a name such as {command(near[0])}, or {NEUTRAL}.",
    )
