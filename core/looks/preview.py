"""A first impression of a trained run without a viewer: photos beside the scene in their looks."""

from collections.abc import Sequence
from pathlib import Path

from core.data.collection import spread_over
from core.export.labelled_sheet import labelled_sheet
from core.export.pictures import tile, to_8_bit, write_png
from core.looks.find_look import look_of_photo
from core.looks.trained import TrainedRun, bake, drawn, neutral_look
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
        own = [bake(trained, look_of_photo(trained, sized.photo, refine=False))] if trained.has_looks else []
        pictures = [to_8_bit(drawn(trained, baked, sized.camera)) for baked in (*own, neutral)]
        rows.append((sized.photo.name, [tile(pixels) for pixels in (sized.pixels, *pictures)]))
    write_png(path := trained.folder / PREVIEW, labelled_sheet(columns, rows))
    return path
