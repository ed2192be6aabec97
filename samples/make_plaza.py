"""Makes samples/plaza: renders the photos and their truth, and writes their COLMAP model.
Everything follows from fixed seeds.

    python samples/make_plaza.py --force                        # the collection, into samples/plaza
    python samples/make_plaza.py --variant calm --output calm   # the same views in one light, with nobody about
    python samples/make_plaza.py --times 3 --output many        # another collection of the same place, of 180 photos
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the work is split over processes instead

import json
import signal
import sys
from dataclasses import asdict
from functools import partial
from multiprocessing import get_context
from operator import call
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from samples.measurements.begin import begin

begin()

import click
import cv2
import numpy as np
from PIL import Image

from core.errors import BadInput, BadSetting
from core.system.atomic import filling
from core.system.outputs import files_in
from samples.measurements import arguments
from samples.plaza_maker import shots
from samples.plaza_maker.light import render
from samples.plaza_maker.looks import Look, develop, to_bytes
from samples.plaza_maker.model import ORIGIN, ROTATION, SCALE, Taken, write_model
from samples.plaza_maker.rays import World
from samples.plaza_maker.shots import Shot
from samples.plaza_maker.square import static_groups
from wegs_cli.main import OneLineErrors
from wegs_cli.terminal import Terminal

SAMPLE = Path(__file__).resolve().parent / "plaza"
TABLE = "plaza.tsv"  # of the photos and their splits
PARTS = (TABLE, "dense", "styles", "truth")  # of a collection
KINDS = "; ".join(f"{name}: {what}" for name, what in shots.VARIANTS.items())
STYLE_VIEWS = 3  # test views rendered in each style's light


def _write(path: Path, picture: np.ndarray, *options: int) -> None:
    """Write an RGB or grey 8-bit picture, in the format that its suffix names."""
    path.parent.mkdir(parents=True, exist_ok=True)
    encoded = cv2.imencode(path.suffix, picture[..., ::-1] if picture.ndim == 3 else picture, options)[1]
    path.write_bytes(encoded.tobytes())


def _take(shot: Shot, output: Path, photo: str, mask: str | None, grid: int) -> tuple[Taken, float]:
    """Take a photo with everybody in it, write it and its mask (white = what stays);
    returns it and the share that passers-by cover."""
    picture = render(World((*static_groups(), *shot.passers_by())), shot.look, shot.view, grid)
    _write(
        output / photo,
        to_bytes(develop(shot.look, picture.radiance), shot.look),
        cv2.IMWRITE_JPEG_QUALITY,
        shot.look.quality,
    )
    moving = picture.transient > 0
    if mask:
        _write(output / mask, np.where(moving, 0, 255).astype(np.uint8), cv2.IMWRITE_PNG_BILEVEL, 1)
    saved = np.asarray(Image.open(output / photo))
    return Taken(f"{shot.name}.jpg", shot.view, saved, picture.depth, moving), float(moving.mean())


def _clean(shot: Shot, look: Look, output: Path, path: str, grid: int) -> None:
    """Write the empty square from where a shot is taken, in a look, without grain."""
    picture = render(World(static_groups()), look, shot.view, grid)
    _write(output / path, to_bytes(develop(look, picture.radiance)), cv2.IMWRITE_PNG_COMPRESSION, 9)


def _rounded(value):
    """The value with all its floats, at any depth, to six digits."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_rounded(item) for item in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _record(shot: Shot, **more) -> dict:
    """What looks.json says of a photo."""
    view = shot.view
    camera = {
        "centre": view.centre.tolist(),
        "world_to_camera": view.world_to_camera.tolist(),
        "focal_px": view.focal_px,
    }
    return {**more, "look": asdict(shot.look), "camera": camera}


def _prepare_worker() -> None:
    """Keep a worker to one thread, and leave Ctrl-C, which reaches all processes of a terminal, to the parent:
    it ends the workers, and pycolmap has no chance to report it."""
    cv2.setNumThreads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def make(output: Path, variant: str | None, times: int, grid: int, processes: int) -> str:
    """Write the whole collection, or a variant of it, into an empty folder; returns what it holds, in words."""
    collection, test = shots.plan(times)
    styles = [] if variant else shots.styles()
    if variant:
        collection = shots.variant(collection, variant)
    tested = [shot for shot in collection if shot.name in test]
    central = sorted(tested, key=lambda shot: abs(shot.view.centre[0]))[:STYLE_VIEWS]
    takes: list[partial] = [
        partial(_take, s, output, f"dense/images/{s.name}.jpg", f"truth/masks/{s.name}.png", grid) for s in collection
    ]
    extra: list[partial] = [partial(_take, s, output, f"styles/{s.name}.jpg", None, grid) for s in styles]
    extra += [partial(_clean, s, s.look, output, f"truth/clean/{s.name}.png", grid) for s in tested]
    extra += [
        partial(_clean, s, t.look, output, f"truth/styles/{t.name}/{s.name}.png", grid) for t in styles for s in central
    ]
    results = []
    with get_context("spawn").Pool(processes, _prepare_worker) as pool, Terminal() as terminal:
        for result in pool.imap(call, takes + extra):
            results.append(result)
            terminal.progress("Pictures", len(results), len(takes) + len(extra))
        pool.close()
        pool.join()
    taken = results[: len(takes)]
    figures = write_model([photo for photo, _ in taken], output / "dense" / "sparse", shots.SEED)
    rows = [
        f"{shot.name}.jpg\t{number}.0\t{'test' if shot.name in test else 'train'}\tplaza"
        for number, shot in enumerate(collection, 1)
    ]
    (output / TABLE).write_text("filename\tid\tsplit\tdataset\n" + "\n".join(rows) + "\n")
    record = {
        "model": {**figures, "scale": SCALE, "rotation": ROTATION.tolist(), "origin": ORIGIN.tolist()},
        "photos": {shot.name: _record(shot, occluded=share) for shot, (_, share) in zip(collection, taken)},
        "styles": {shot.name: _record(shot) for shot in styles},
    }
    (output / "truth" / "looks.json").write_text(
        json.dumps(_rounded(record), separators=(",", ":")).replace('},"0', '},\n"0') + "\n"
    )
    return f"{len(collection)} photos, {len(test)} of them test; {figures}"


@click.command(cls=OneLineErrors)
@click.option(
    "-o", "--output", type=arguments.PATH, default=SAMPLE, show_default="samples/plaza", help="Folder to write."
)
@click.option("--variant", type=click.Choice(list(shots.VARIANTS)), help=f"{KINDS}; needs --output.")
@arguments.count("--times", 1, "So many times the photos of each light; needs --output.")
@arguments.count("--grid", 2, "Sub-samples per pixel along each side; 1 is a quick look.")
@arguments.count("--processes", 2, "Processes to work in.")
@click.option("--force", is_flag=True, help="Replace the folder if it holds such a collection.")
def main(output: Path, variant: str | None, times: int, grid: int, processes: int, force: bool) -> None:
    """Make the plaza sample: photos, truth and COLMAP model."""
    if (variant or times != 1) and output.resolve() == SAMPLE:
        raise BadSetting("This would replace the committed sample by another.", "Name another folder with --output.")
    if output.is_dir() and files_in(output) and not (output / TABLE).is_file():
        raise BadInput(f"{output} is no collection made here.", "Name another folder with --output.")
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C, and not by pycolmap, which has set its own
    with filling(output, PARTS, force) as work:
        made = make(work, variant, times, grid, processes)
    click.echo(f"{output}: {made}")


if __name__ == "__main__":
    main()
