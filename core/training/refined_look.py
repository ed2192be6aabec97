"""A look refined against the photo that it was read from: one that was not trained on, whose camera is known or can be found."""

from dataclasses import replace
from functools import partial
from math import sqrt
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from core.appearance import refinement
from core.data import load_collection
from core.data import photos as files
from core.data.collection import Photo
from core.data.locate import locate
from core.data.photo_file import probe
from core.errors import BadInput
from core.report import Report
from core.scene.camera import Camera
from core.training.pictures import Picture, shown_on
from core.training.trained import Appearance, Run


def refined_held_out(trained: Run, look: Appearance, picture: Picture, report: Report) -> Appearance:
    """The look of a held-out photo. That of a training photo would be no better for it: the encoder has learnt it by heart."""
    pixels, valid = shown_on(trained.device, picture.pixels, picture.valid)
    refined = _refined(trained, look, picture.camera, pixels, valid, report)
    return look if refined is None else replace(refined, source=f"{look.source}, refined")


def refined_outside(trained: Run, look: Appearance, path: Path, mask: Path | None, report: Report) -> Appearance:
    """The look of a photo file from outside the collection, as it was read where it is not found out where the photo was taken.

    It is drawn at its own size, or that of a training photo if that is smaller. mask: white where the photo is to be used.
    """
    if trained.settings.appearance == "off":
        return look
    try:
        collection = load_collection(trained.collection.root)
    except BadInput:  # moved or removed since
        return replace(look, source=f"{look.source}, not refined: the scene cannot be read")
    found = locate(path, collection, report, mask)
    if found is None:
        return replace(look, source=f"{look.source}, not refined: where it was taken was not found")
    camera = found.camera.in_world(collection.frame).in_scene(trained.collection.frame)
    camera = _no_larger(camera, np.mean([each.width * each.height for each in map(trained.camera, trained.collection.photos)]))
    photo = Photo(path.name, path, camera.resized(*probe(path).displayed), "test", np.zeros(0, dtype=np.int64), mask=mask)
    picture = files.load(photo, camera.width, camera.height, trained.is_cut_out)
    pixels, valid = shown_on(trained.device, picture.pixels, picture.valid)
    refined = _refined(trained, look, camera, pixels, valid, report)
    how = f"refined from where it was taken ({found.agreeing} of {found.matched} features agree)"
    return look if refined is None else replace(refined, source=f"{look.source}, {how}")


def _no_larger(camera: Camera, most_pixels: float) -> Camera:
    shrink = min(1.0, sqrt(most_pixels / (camera.width * camera.height)))
    return camera.resized(max(1, round(shrink * camera.width)), max(1, round(shrink * camera.height)))


def _refined(
    trained: Run,
    look: Appearance,
    camera: Camera,
    pixels: Float[Tensor, "h w 3"],
    valid: Bool[Tensor, "h w"] | None,
    report: Report,
) -> Appearance | None:
    """None where looks follow no embedding."""
    render = partial(trained.render, camera=camera, tone=look.tone)
    best = None
    for step, best in enumerate(refinement.refinement(render, look.embedding, pixels, valid)):
        report.progress("Refinement", step, refinement.STEPS)
    return None if best is None else replace(look, embedding=best)
