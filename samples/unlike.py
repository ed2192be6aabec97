"""How close looks come to photos in a light that no training photo has, with and without the gains of sky and place.

    python samples/unlike.py samples/plaza --by dark
    python samples/unlike.py statue_of_liberty --by dark -r 2

The darkest (or warmest, or brightest) quarter of a scene's training photos is held out, and a run is trained on the
others. Each photo of that quarter is then read like one from outside; its look is rendered with the photo's camera and
compared with the photo where that is valid and, if the true masks are known, static. The scene's own held-out photos
are not used.
"""

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from samples.measurements.begin import begin

begin()

import click
import torch

from core.appearance.colouring import Colouring
from core.config import Settings
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
from samples.measurements import arguments
from wegs_cli.main import OneLineErrors
from wegs_cli.terminal import Terminal

# A function of a photo's mean colour; the quarter of the photos for which it is least is held out.
LIGHTS = {
    "dark": lambda red, green, blue: red + green + blue,
    "bright": lambda *colour: -sum(colour),
    "warm": lambda red, _, blue: blue / max(red, 1),
}
SMALL_PX = 64  # width of the picture from which a photo's mean colour is taken


@click.command(cls=OneLineErrors)
@arguments.scene
@click.option(
    "--by", type=click.Choice(list(LIGHTS)), default="dark", show_default=True, help="Which photos are held out."
)
@arguments.preset
@arguments.steps()
@arguments.resolution()
def main(scene: Path, by: str, preset_name: str, steps: int | None, resolution: int) -> None:
    """Train SCENE without the photos of one light and show it these."""
    whole = load_collection(scene)
    if not len(whole.points):
        raise BadInput(f"{scene} has no points.", "Give the folder NAME-scene that `wegs train` keeps beside its run.")
    collection = without(whole, by)
    settings = arguments.settings_of(preset_name, steps, resolution=resolution)
    with Terminal() as terminal, tempfile.TemporaryDirectory() as folder:
        trained = train(collection, settings, Path(folder), terminal)
        photos = [compared(trained, photo) for photo in collection.split("test")]
    beyond = [photo for photo in photos if photo.distance > 1]
    for what, chosen in (("all", photos), ("beyond the known range", beyond)):
        means = ""
        if chosen:
            drawn_in = fmean(photo.drawn_in for photo in chosen)
            with_gains = fmean(photo.with_gains for photo in chosen)
            means = f": {drawn_in:.2f} dB drawn in, {with_gains:.2f} dB with gains"
        click.echo(f"{what}, {len(chosen)} of {len(photos)} photos{means}")


def without(collection: Collection, by: str) -> Collection:
    """The collection without its held-out photos, a quarter of the others held out instead.
    Raises BadInput where these are too few for that."""

    def key(photo: Photo) -> float:
        height = max(1, SMALL_PX * photo.camera.height // photo.camera.width)
        return LIGHTS[by](*load_photo(photo, SMALL_PX, height).pixels.mean(axis=(0, 1)))

    ranked = sorted(collection.split("train"), key=key)
    held_out = {photo.name for photo in ranked[: len(ranked) // 4]}
    if not held_out:
        raise BadInput(
            f"{collection.root} has {counted(len(ranked), 'training photo')}, too few to hold out a quarter.",
            "Use one of 4 or more.",
        )
    left = (replace(photo, split="test" if photo.name in held_out else "train") for photo in collection.split("train"))
    return replace(collection, photos=tuple(left))


def train(collection: Collection, settings: Settings, folder: Path, terminal: Terminal) -> TrainedRun:
    """A finished run in `folder`; BadInput, before it is trained, where it would have one look only."""
    trainer = Trainer.of_new_run(collection, settings, folder)
    if not trainer.settings.has_looks:
        raise BadInput(
            "A run would have one look only, and nothing is read from photos.",
            "Take a scene whose photos differ in their light, and a --preset with looks.",
        )
    for report in trainer.train():
        terminal.progress("Training", report.step, trainer.settings.steps)
    return load_run(folder)


@dataclass(frozen=True)
class Compared:
    """distance: how far out a photo's embedding lies (1: the end of the known range). drawn_in, with_gains: PSNR (dB)
    of the photo's look with the embedding moved into that range, and with the gains of sky and place."""

    distance: float
    drawn_in: float
    with_gains: float


@torch.no_grad()
def compared(trained: TrainedRun, photo: Photo) -> Compared:
    """The looks of a held-out photo beside the photo itself."""
    view = held_out_view(trained, photo)
    known = [part for part in (view.valid, view.truth.static) if part is not None]
    scored = torch.stack(known).all(dim=0) if known else None
    picture = view.picture.permute(2, 0, 1)
    embedding = trained.model.embedding_from_outside(picture)
    looks = Colouring(trained.known_range.nearest(embedding)), read_from_outside(trained, picture)
    images = (drawn(trained, bake(trained, Look("", "", look)), view.camera) for look in looks)
    return Compared(
        trained.known_range.distance(embedding), *(psnr(quantised(image), view.picture, scored) for image in images)
    )


if __name__ == "__main__":
    main()
