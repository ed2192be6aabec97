"""Photos in a light that no training photo has: how close their looks come to them, with and without the gains of sky and place.

    python samples/unlike.py samples/plaza --by dark
    python samples/unlike.py statue_of_liberty --by dark -r 2

The darkest (or warmest, or brightest) quarter of a scene's training photos is held out, and the run is trained on the others. Each photo of the
quarter is then read as one from outside; its look is rendered with the photo's camera and compared with the photo where that is valid and, if
the scene's passers-by are known, static. The scene's own held-out photos are not used.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from core.system.process import prepare

prepare()  # before torch is imported

import click
import numpy as np
import torch

from core.appearance.colouring import Colouring
from core.config import Settings, preset
from core.data import load_collection
from core.data.collection import Collection, Photo
from core.data.photos.pixels import load_photo
from core.errors import BadInput
from core.evaluation.metrics import psnr, quantised
from core.looks.held_out_views import held_out_view
from core.looks.outside import read_from_outside
from core.looks.trained import Look, TrainedRun, bake, drawn, load_run
from core.training.trainer import Trainer
from core.words import counted
from wegs_cli.main import OneLineErrors
from wegs_cli.terminal import Terminal

# A function of a photo's mean colour; the quarter of the photos for which it is least is held out.
LIGHTS = {"dark": lambda red, green, blue: red + green + blue, "bright": lambda *colour: -sum(colour), "warm": lambda red, _, blue: blue / red}
SMALL_PX = 64  # wide: of what tells a photo's mean colour


@click.command(cls=OneLineErrors)
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--by", type=click.Choice(list(LIGHTS)), default="dark", show_default=True)
@click.option("--preset", "preset_name", default="quick", show_default=True)
@click.option("--steps", type=int, help="Training steps.  [default: the preset's]")
@click.option("-r", "--resolution", type=int, default=-1, show_default=True)
def main(scene: Path, by: str, preset_name: str, steps: int | None, resolution: int) -> None:
    """Train SCENE without the photos of one light and show it these."""
    collection = without(load_collection(scene), by)
    settings = preset(preset_name).changed(resolution=resolution, **({} if steps is None else {"steps": steps}))
    with Terminal() as terminal, tempfile.TemporaryDirectory() as folder:
        trained = train(collection, settings, Path(folder), terminal)
        rows = np.array([compared(trained, photo) for photo in collection.split("test")])
    for what, chosen in (("all", rows), ("beyond the known range", rows[rows[:, 0] > 1])):
        means = f": {chosen[:, 1].mean():.2f} dB drawn in, {chosen[:, 2].mean():.2f} dB with gains" if len(chosen) else ""
        click.echo(f"{what}, {len(chosen)} of {len(rows)} photos{means}")


def without(collection: Collection, by: str) -> Collection:
    """The training photos alone, a quarter of them held out. Raises BadInput where they are too few for that."""

    def key(photo: Photo) -> float:
        height = max(1, SMALL_PX * photo.camera.height // photo.camera.width)
        return LIGHTS[by](*load_photo(photo, SMALL_PX, height).pixels.mean(axis=(0, 1)))

    ranked = sorted(collection.split("train"), key=key)
    held_out = {photo.name for photo in ranked[: len(ranked) // 4]}
    if not held_out:
        raise BadInput(f"{collection.root} has {counted(len(ranked), 'training photo')}, too few to hold out a quarter.", "Use one of 4 or more.")
    left = (replace(photo, split="test" if photo.name in held_out else "train") for photo in collection.split("train"))
    return replace(collection, photos=tuple(left))


def train(collection: Collection, settings: Settings, folder: Path, terminal: Terminal) -> TrainedRun:
    """A finished run in `folder`."""
    trainer = Trainer.of_new_run(collection, settings, folder)
    for report in trainer.train():
        terminal.progress("Training", report.step, trainer.settings.steps)
    return load_run(folder)


@torch.no_grad()
def compared(trained: TrainedRun, photo: Photo) -> tuple[float, float, float]:
    """How far out a photo's embedding lies (1: the end of the known range), the PSNR of its look moved into that range, and that with gains."""
    view = held_out_view(trained, photo)
    scored = [part for part in (view.valid, view.truth.static) if part is not None]
    scored = torch.stack(scored).all(dim=0) if scored else None
    picture = view.picture.permute(2, 0, 1)
    embedding = trained.model.embedding_from_outside(picture)
    looks = Colouring(trained.known_range.nearest(embedding)), read_from_outside(trained, picture)
    images = (drawn(trained, bake(trained, Look("", "", look)), view.camera) for look in looks)
    return trained.known_range.distance(embedding), *(psnr(quantised(image), view.picture, scored) for image in images)


if __name__ == "__main__":
    main()
