"""Draws held-out photos beside plain 3DGS and a run's looks, each with its PSNR.

    python samples/beside_plain.py RUN PLAIN --photo 0006.jpg --photo 0058.jpg -o beside_plain.jpg

PLAIN: a run of the same scene with --preset vanilla. A row for each photo: the photo | PLAIN | RUN in the look that is
read from the photo (zero-shot) | that look refined, by protocol `full`. PSNR is against the truth without people where
that is known, else against the photo.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from samples.measurements.begin import begin

begin()

import click
import numpy as np
import torch
from jaxtyping import UInt8

from core.appearance.colouring import Colouring
from core.data.collection import Photo, spread_over
from core.errors import BadInput
from core.evaluation.metrics import psnr, quantised
from core.evaluation.protocols import fit_of, refined
from core.export.labelled_sheet import labelled_sheet
from core.export.pictures import tile, to_8_bit
from core.looks.held_out_views import held_out_view
from core.looks.trained import TrainedRun, bake, drawn, neutral_look
from core.pipeline.opened import open_run
from core.scene.splats import Splats
from core.system.outputs import check_replaceable
from samples.measurements import arguments
from samples.measurements.jpeg import write_jpeg
from samples.measurements.opened import opened
from wegs_cli.main import OneLineErrors
from wegs_cli.terminal import Terminal

TITLES = "held-out photo", "plain 3DGS", "wegs: look read from the photo", "wegs: refined"
PHOTOS = 3  # without --photo, evenly spread

Row = tuple[str, list[UInt8[np.ndarray, "h w 3"]]]


@click.command(cls=OneLineErrors)
@click.argument("run_folder", metavar="RUN", type=arguments.PATH)
@click.argument("plain_folder", metavar="PLAIN", type=arguments.PATH)
@click.option("--photo", "names", multiple=True, help="Held-out photo; repeatable.  [default: three of them]")
@click.option("-o", "--output", type=arguments.PATH, default="beside_plain.jpg", show_default=True, help="The sheet.")
@click.option("--force", is_flag=True, help="Replace what is there.")
def main(run_folder: Path, plain_folder: Path, names: tuple[str, ...], output: Path, force: bool) -> None:
    """Draw held-out photos beside PLAIN, a run of plain 3DGS, and the looks of RUN."""
    check_replaceable(output, force)
    trained, held_out = opened(run_folder)
    plain = open_run(plain_folder, Terminal())
    if plain.has_looks:
        raise BadInput(f"{plain_folder} has looks, which plain 3DGS has not.", "Train it with --preset vanilla.")
    photos = [trained.collection.photo(name) for name in names] or spread_over(held_out, PHOTOS)
    rows, baked = [], bake(plain, neutral_look(plain))
    with Terminal() as terminal:
        for done, photo in enumerate(photos, 1):
            rows.append(row(trained, plain, baked, photo))
            terminal.say(rows[-1][0])
            terminal.progress("Photos", done, len(photos))
        write_jpeg(output, labelled_sheet(TITLES, rows), terminal)


@torch.no_grad()
def row(trained: TrainedRun, plain: TrainedRun, baked: Splats, photo: Photo) -> Row:
    """The figures of a photo in words, and its pictures. baked: the Gaussians of `plain`."""
    view = held_out_view(trained, photo)
    fit = fit_of(trained, view, "full")
    looks = Colouring(fit.start), refined(trained, fit)
    seen = trained.seen_by(view.camera)
    camera = plain.camera(plain.collection.photo(photo.name)).resized(view.camera.width, view.camera.height)
    renders = [drawn(plain, baked, camera), *(seen.render(look) for look in looks)]
    truth, valid = (view.picture, view.valid) if view.truth.clean is None else (view.truth.clean, None)
    figures = [f"{psnr(quantised(render), quantised(truth), valid):.1f} dB" for render in renders]
    words = f"{photo.name}  plain {figures[0]}, zero-shot {figures[1]}, refined {figures[2]}"
    return words, [tile(to_8_bit(picture)) for picture in (view.picture, *renders)]


if __name__ == "__main__":
    main()
