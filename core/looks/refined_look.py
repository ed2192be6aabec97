"""Refines a look against the photo that it was read from, if the photo's camera is known or can be found."""

from dataclasses import replace
from functools import partial
from math import sqrt
from pathlib import Path

from jaxtyping import Bool, Float
from torch import Tensor

from core.appearance.refinement import last, refinement_steps
from core.data.collection import Photo
from core.data.photos.pixels import load_photo
from core.errors import BadInput
from core.looks.locate import locate
from core.looks.trained import Look, TrainedRun
from core.report import QUIET, Report
from core.run.sized_photo import SizedPhoto, as_tensors
from core.scene.camera import Camera


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
        found = locate(trained, look, path, mask, report)
        if found is None:
            return not_refined(
                look, "its camera could not be located (too little of it agrees with what the training photos show)"
            )
        sizes = [each.width * each.height for each in map(trained.camera, trained.collection.photos)]
        camera = found.camera.shrunk(sqrt(sum(sizes) / len(sizes) / (found.camera.width * found.camera.height)))
        photo = Photo.from_outside(path, found.camera, mask)
        loaded = load_photo(photo, camera.width, camera.height, trained.settings.transparent_is_empty)
    except BadInput as problem:  # with a mask: in a smaller picture, nothing of it is left
        too_fine = "too little of it is left at the size at which it is drawn"
        return not_refined(look, too_fine if mask is not None else problem.what)
    pixels, valid = as_tensors(loaded.pixels, loaded.valid, trained.device)
    better = refined(trained, look, camera, pixels, valid, report)
    how = f"refined from where it was taken ({found.inliers} of {found.matches} places agree)"
    return replace(better, source=f"{look.source}, {how}")


def not_refined(look: Look, why: str) -> Look:
    """The look as it was read; its source says why it was not refined. why: with or without its full stop."""
    return replace(look, source=f"{look.source}, not refined: {why.removesuffix('.')}")


def refined(
    trained: TrainedRun,
    look: Look,
    camera: Camera,
    pixels: Float[Tensor, "h w 3"],
    valid: Bool[Tensor, "h w"] | None,
    report: Report = QUIET,
) -> Look:
    """The look refined so that `camera` sees in it what the photo shows: pixels in [0, 1]."""
    course = refinement_steps(
        trained.seen_by, look.colouring, camera, pixels, valid, partial(report.progress, "Refinement")
    )
    return replace(look, colouring=last(course))
