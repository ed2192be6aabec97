"""A first impression of a run, in training or finished, without a viewer: photos beside the scene in their looks."""

from collections.abc import Sequence
from pathlib import Path

from core.appearance.colouring import Colouring
from core.data.collection import spread_over
from core.export.labelled_sheet import labelled_sheet
from core.export.pictures import tile, to_8_bit, write_png
from core.looks.trained import Look, TrainedRun, bake, drawn, neutral_look
from core.run.run_folders import PREVIEW
from core.run.sized_photo import SizedPhoto

PHOTOS = 4


def write_preview(trained: TrainedRun, photos: Sequence[SizedPhoto]) -> Path:
    """Write PREVIEW into the run folder: up to PHOTOS training photos, each beside the scene from its camera.

    The scene is shown in the photo's look as the encoder reads it, and in the neutral one.
    """
    columns = (
        ("photo", "in its look, not refined", "in the neutral look") if trained.has_looks else ("photo", "the scene")
    )
    neutral, rows = bake(trained, neutral_look(trained)), []
    for sized in spread_over(photos, PHOTOS):
        own = [bake(trained, _as_read(trained, sized))] if trained.has_looks else []
        pictures = [to_8_bit(drawn(trained, baked, sized.camera)) for baked in (*own, neutral)]
        rows.append((sized.photo.name, [tile(pixels) for pixels in (sized.pixels, *pictures)]))
    write_png(path := trained.folder / PREVIEW, labelled_sheet(columns, rows))
    return path


def _as_read(trained: TrainedRun, sized: SizedPhoto) -> Look:
    """The look of a training photo as the model reads it now, in the midst of training as well.
    The photo's file is not needed, which may be gone by then."""
    name = sized.photo.name
    reading = trained.model.read(sized.encoder_input, trained.model.row_of(name))
    return Look(name, f"training photo {name}", Colouring(reading.embedding))
