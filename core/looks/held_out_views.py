"""A run's held-out photos as the views on which the protocols of core.evaluation measure it."""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from core.data.collection import Photo
from core.data.photos.file import named_with_fault
from core.errors import BadInput
from core.evaluation.protocols import HeldOutView
from core.evaluation.truth import load_truth
from core.looks.trained import TrainedRun
from core.report import Report
from core.run.sized_photo import as_tensors
from core.words import name_them

Measured = TypeVar("Measured")


def held_out_view(trained: TrainedRun, photo: Photo) -> HeldOutView:
    """A held-out photo at training size, with its truth if that is known;
    BadInput if the photo is missing or damaged."""
    sized = trained.sized_photo(photo)
    camera = sized.camera
    pixels, valid = as_tensors(sized.pixels, sized.valid, trained.device)
    truth = load_truth(trained.collection.root, photo.name, camera.width, camera.height)
    return HeldOutView(photo.name, pixels, camera, valid, truth.to(trained.device))


def over_views(
    trained: TrainedRun,
    photos: Sequence[Photo],
    measure: Callable[[HeldOutView], Measured],
    what: str,
    report: Report,
    left_out: str = "not measured",
) -> Iterator[tuple[Photo, Measured]]:
    """(photo, measure(view)) for each photo, one at a time, because pictures are large. Photos that raise BadInput are
    skipped and named in a warning at the end; if all do, the last BadInput is raised. what: the work, for the progress
    bar. left_out: what to say of skipped photos, after "3 photos"."""
    unusable = []
    for number, photo in enumerate(photos, 1):
        try:
            result = measure(held_out_view(trained, photo))
        except BadInput as problem:
            unusable.append(named_with_fault(photo.name, photo.path, problem))
            if len(unusable) == len(photos):
                raise
        else:
            yield photo, result
        report.progress(what, number, len(photos), photo.name)
    for note in name_them(left_out, unusable):
        report.warn(note.text)
