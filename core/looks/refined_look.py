"""Refines a look against the photo that it was read from, if the photo's camera is known or can be found."""

from dataclasses import replace
from functools import partial
from math import sqrt
from pathlib import Path

from jaxtyping import Bool, Float
from torch import Tensor

from core.data import load_collection
from core.data.collection import Photo
from core.data.photos.pixels import load_photo
from core.data.sfm.landmarks import FILE, Landmarks, known_photos, landmarks_of
from core.data.sfm.locate import Located, locate
from core.errors import BadInput, WegsError
from core.evaluation.subject import last, refining_to
from core.looks.aligned import align
from core.looks.trained import Look, TrainedRun
from core.report import QUIET, Report
from core.run.run_config import check_same_run, scene_gone
from core.run.sized_photo import SizedPhoto, as_tensors
from core.scene.camera import Camera
from core.words import counted


def refined_of_collection(trained: TrainedRun, look: Look, sized: SizedPhoto, report: Report) -> Look:
    """The look of a photo of the collection, refined."""
    pixels, valid = as_tensors(sized.pixels, sized.valid, trained.device)
    better = refined(trained, look, sized.camera, pixels, valid, report)
    return replace(better, source=f"{look.source}, refined")


def refined_outside(trained: TrainedRun, look: Look, path: Path, mask: Path | None, report: Report) -> Look:
    """The look of a photo file from outside the collection, refined;
    unchanged if the photo cannot be located, with the reason in `source`.

    The photo is compared at its own size or, if that is smaller, the mean size of the run's photos in training. mask:
    white where it is to be used.
    """
    if not trained.has_looks:
        return look
    try:
        found = located(trained, look, path, mask, report)
    except BadInput as problem:
        return not_refined(look, problem.what)
    if found is None:
        return not_refined(
            look, "its camera could not be located (too little of it agrees with what the training photos show)"
        )
    sizes = [each.width * each.height for each in map(trained.camera, trained.collection.photos)]
    photo = Photo.from_outside(path, found.camera, mask)
    camera = found.camera.shrunk(sqrt(sum(sizes) / len(sizes) / (found.camera.width * found.camera.height)))
    try:
        loaded = load_photo(photo, camera.width, camera.height, trained.transparent_is_empty)
    except BadInput as problem:  # with a mask: in the smaller picture, nothing of it is left
        too_fine = "too little of it is left at the size at which it is drawn"
        return not_refined(look, too_fine if mask is not None else problem.what)
    pixels, valid = as_tensors(loaded.pixels, loaded.valid, trained.device)
    better = refined(trained, look, camera, pixels, valid, report)
    how = f"refined from where it was taken ({found.agreeing} of {found.matched} {found.kind} agree)"
    return replace(better, source=f"{look.source}, {how}")


def located(trained: TrainedRun, look: Look, path: Path, mask: Path | None, report: Report) -> Located | None:
    """Where a photo file, whose look this is, was taken: as its features tell, most exactly, or, where too few of them
    match, pictures of the scene. Raises BadInput for a photo that cannot be read, or that its mask hides altogether."""
    found = None
    try:
        landmarks = landmarks_of_run(trained, report)
    except BadInput as problem:
        report.warn(f"{problem.what.removesuffix('.')}; so {path.name} is looked for by pictures of the scene alone.")
    else:
        found = locate(path, landmarks, report, mask)
    return found or align(trained, look, path, mask, report)


def not_refined(look: Look, why: str) -> Look:
    """The look as it was read; its source says why it was not refined. why: with or without its full stop."""
    return replace(look, source=f"{look.source}, not refined: {why.removesuffix('.')}")


def landmarks_of_run(trained: TrainedRun, report: Report) -> Landmarks:
    """The landmarks by which photos from outside are located, in the run's scene frame:
    found once, then kept in the run folder.

    They are not kept as long as some of the training photos that they should come from cannot be read. Raises BadInput
    if none are kept and the scene cannot be read, has other cameras by now, or does not say which photo shows which
    point.
    """
    path = trained.folder / FILE
    if (kept := Landmarks.load(path, trained.identity)) is not None:
        return kept
    if not trained.collection.root.is_dir():
        raise scene_gone(trained.folder, trained.collection, "the features of its photos cannot be read")
    collection = load_collection(trained.collection.read_from, trained.settings.all_photos)
    if not collection.in_world_of(trained.collection):
        raise BadInput(
            f"The cameras of {collection.root} are not those that {trained.folder} was trained with.", "Train it again."
        )
    names = set(trained.model.photo_names)
    collection = replace(
        collection, photos=tuple(replace(photo, split="train") for photo in collection.photos if photo.name in names)
    )
    if not (known := known_photos(collection)):
        raise BadInput(
            f"{collection.root} does not tell which photo shows which point.", "Use the COLMAP model with its points."
        )
    report.say("Extracting features of the training photos (first time only), to locate the new photo")
    found = landmarks_of(collection, report).in_frame(collection.frame, trained.collection.frame)
    if lost := len(names) - len(collection.photos) or len(known) - len(found.counts):
        missing = f"{counted(lost, 'training photo')} of {len(names)} cannot be read now"
        report.warn(f"{missing}. The others serve this time; next time all are searched again.")
        return found
    try:
        check_same_run(trained.folder, trained.identity)
        found.save(path, trained.identity)
    except WegsError as problem:
        report.warn(f"{problem.what} The next new photo has the features extracted again.")
    return found


def refined(
    trained: TrainedRun,
    look: Look,
    camera: Camera,
    pixels: Float[Tensor, "h w 3"],
    valid: Bool[Tensor, "h w"] | None,
    report: Report = QUIET,
) -> Look:
    """The look refined so that `camera` sees in it what the photo shows: pixels in [0, 1]."""
    course = refining_to(trained, look.colouring, camera, pixels, valid, partial(report.progress, "Refinement"))
    return replace(look, colouring=last(course))
