"""How well photos from outside are located, and what refining their looks from there gains.

    python samples/located.py RUN

Each held-out photo of RUN (default: the newest) is located like a file of unknown origin. By protocol `half`, its look
is then read from the left half, refined on it with the camera that was found, and scored on the right half with the
known camera.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from samples.measurements.begin import begin

begin()

import click
import numpy as np
import torch

from core.appearance.colouring import Colouring
from core.data import load_collection
from core.data.collection import Collection, Photo
from core.evaluation.protocols import fit_of, refined
from core.looks.find_look import look_of_file
from core.looks.held_out_views import held_out_view
from core.looks.locate import locate
from core.looks.trained import TrainedRun
from core.report import QUIET
from core.scene.camera import Camera
from samples.measurements import arguments
from samples.measurements.opened import opened
from wegs_cli.main import OneLineErrors

WIDTH_PX = 400  # of the picture in which a camera's error is measured
FIGURES = "zero-shot {:.2f}, refined from there {:.2f}, refined from the known camera {:.2f} dB"


@click.command(cls=OneLineErrors)
@arguments.run
def main(run_folder: Path | None) -> None:
    """Locate the held-out photos of RUN, and refine their looks from there."""
    trained, held_out = opened(run_folder)
    collection = load_collection(trained.collection.read_from)
    rows = []
    for photo in held_out:
        look, begun = look_of_file(trained, photo.path), time.perf_counter()
        found = locate(trained, look, photo.path, None, QUIET)
        seconds = time.perf_counter() - begun
        if found is None:
            click.echo(f"{photo.name}: not found")
            continue
        off = off_px(found.camera, collection.photo(photo.name), collection)
        decibels = scores(trained, photo, found.camera)
        agree = f"{found.inliers} of {found.matches} places agree"
        click.echo(f"{photo.name}: {agree}, {off_in_words(off, seconds)}; {FIGURES.format(*decibels)}")
        rows.append((off, seconds, *decibels))
    click.echo(f"{len(rows)} of {len(held_out)} found")
    if rows:
        offs, taken, *columns = np.array(rows).T
        means = (column.mean() for column in columns)
        click.echo(f"median {off_in_words(np.median(offs), np.median(taken))}; mean of {FIGURES.format(*means)}")


def off_in_words(off: float, seconds: float) -> str:
    """How far off a camera was found, px, and in what time."""
    return f"{off:.2f} px of {WIDTH_PX} off in {seconds:.1f} s"


def off_px(camera: Camera, photo: Photo, collection: Collection) -> float:
    """The median distance, in px of a picture of WIDTH_PX, between the photo's SfM points as both cameras see them."""
    rows = photo.points if len(photo.points) else photo.camera.shows(collection.points)[0]
    points = collection.points[rows]
    height = max(1, round(WIDTH_PX * photo.camera.height / photo.camera.width))
    there, known = (each.resized(WIDTH_PX, height).project(points)[0] for each in (camera, photo.camera))
    return float(np.median(np.linalg.norm(there - known, axis=1)))


@torch.no_grad()
def scores(trained: TrainedRun, photo: Photo, found: Camera) -> list[float]:
    """PSNR (dB) of the right half in the look of the left one:
    zero-shot, refined with the camera that was found, and with the known one."""
    view = held_out_view(trained, photo)
    fits = [
        fit_of(trained, replace(view, camera=camera), "half")
        for camera in (found.resized(view.camera.width, view.camera.height), view.camera)
    ]
    looks = [Colouring(fits[0].start), *(refined(trained, fit) for fit in fits)]
    seen = trained.seen_by(view.camera)
    return [fits[0].psnr(seen.render(look)) for look in looks]


if __name__ == "__main__":
    main()
