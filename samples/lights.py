"""Draws the README's pictures of looks: a run, from one camera,
in the looks of its own photos and of photos from outside.

    python samples/lights.py                   # of the newest run of samples/plaza: lights.jpg and styles.jpg
    python samples/lights.py RUN --style night.jpg --style noon.jpg --view 0012.jpg -o sheet.jpg  # of anyone's run
    python samples/lights.py RUN --style night.jpg --renders --view 0012.jpg --view 0040.jpg -o sheet.jpg
                                               # without its photos
    python samples/lights.py RUN --style 0012.jpg --style night.jpg --grid --view 0012.jpg -o grid.jpg
                                               # as lights.jpg, of anyone's run

lights.jpg (without -o or --style): six looks, each with its photo in a corner. styles.jpg, or the file of -o: a row for
each style photo (photo | neutral | its look | truth if it is known), and below them the looks between the first style
(or neutral) and the last. If the truth is known, the script also prints how close the look comes to it in PSNR (dB),
beside the nearest look of a training photo and the look fitted to the truth itself. With --renders: a row for each
view, with the neutral look and each style's, but no photos, whose licences may not allow it.
"""

import sys
from filecmp import cmp
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from samples.measurements.begin import begin

begin()

import click
import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from core.data.collection import Photo
from core.data.photos.pixels import read_pixels
from core.errors import BadInput
from core.evaluation import metrics
from core.export.pictures import to_8_bit
from core.looks.find_look import find_look, look_of_photo
from core.looks.refined_look import refined
from core.looks.trained import Look, TrainedRun, bake, blend, drawn, neutral_look
from core.pipeline.opened import open_run
from core.report import Report
from core.scene.camera import Camera
from core.scene.splats import Splats
from core.system.outputs import check_replaceable
from core.words import counted
from samples.measurements import arguments
from samples.measurements.jpeg import write_jpeg
from wegs_cli.main import OneLineErrors
from wegs_cli.terminal import Terminal

PLAZA_LOOKS = (
    "neutral",
    "0006.jpg",
    "0027.jpg",
    "0058.jpg",
    *(str(HERE / f"plaza/styles/{s}.jpg") for s in ("noon", "dusk")),
)
PLAZA_VIEWS = "0006.jpg", "0040.jpg"  # held out; of lights.jpg and of styles.jpg
TILE_PX, LARGE_PX = 180, 240  # height of each picture of the sheet, and of lights.jpg
# Height of a photo within the picture of its look, as a share of that, and the width of its white frame.
INSET, FRAME_PX = 0.3, 2
FRAMES = 6  # of the strip


@click.command(cls=OneLineErrors)
@arguments.run
@click.option(
    "--style", "styles", multiple=True, help="Photo from outside; repeatable.  [default: the two of samples/plaza]"
)
@click.option(
    "--view",
    "views",
    multiple=True,
    help="Photo of the run from whose camera the looks are seen.  [default: a held-out one]",
)
@click.option(
    "--grid", is_flag=True, help="Draw the looks of --style in rows of three, each with its photo in a corner."
)
@click.option("--renders", is_flag=True, help="Draw no photos, but the looks in a row for each --view.")
@click.option("-o", "--output", type=arguments.PATH, help="The sheet.  [default: styles.jpg]")
@click.option("--force", is_flag=True, help="Replace what is there.")
def main(
    run_folder: Path | None,
    styles: tuple[str, ...],
    views: tuple[str, ...],
    grid: bool,
    renders: bool,
    output: Path | None,
    force: bool,
) -> None:
    """Draw the looks of RUN (default: the newest)."""
    trained = open_run(run_folder, Terminal())
    lights, output = None if output or styles else Path("lights.jpg"), output or Path("styles.jpg")
    if output.suffix.lower() not in (".jpg", ".jpeg"):
        raise BadInput(f"{output} is not named like a JPEG.", "End it in .jpg.")
    for path in filter(None, (lights, output)):
        check_replaceable(path, force)
    if grid and (renders or not styles):
        raise BadInput(
            "--grid draws the looks of --style beside their photos.", "Add --style PHOTO, and leave --renders out."
        )
    if len(views) > 1 and not renders:
        raise BadInput("Without --renders one --view is drawn.", "Add --renders, or leave the others out.")
    if not styles and (renders or not {*PLAZA_VIEWS} <= {photo.name for photo in trained.collection.photos}):
        raise BadInput("The styles drawn by default are of samples/plaza, beside their photos.", "Add --style PHOTO.")
    if not styles:
        styles, views = PLAZA_LOOKS[-2:], views or PLAZA_VIEWS[1:]
    seen_from = [trained.collection.photo(view) for view in views or (None,)]
    for style in styles:
        find_look(trained, style, refine=False)  # refuses it before others are refined
        if grid and style != "neutral":
            source(trained, style)
        if not (grid or renders or Path(style).is_file()):
            raise BadInput(
                f"{style} is no photo that could be drawn beside its look.", "Give a path, or add --renders."
            )
    with Terminal() as terminal:
        appearances = dict.fromkeys(("neutral", *styles, *(() if lights is None else PLAZA_LOOKS)))
        looks = {name: find_look(trained, name, report=terminal) for name in appearances}  # each takes seconds
        if lights is not None:
            write_rows(
                lights,
                grid_of({word: looks[word] for word in PLAZA_LOOKS}, trained, trained.collection.photo(PLAZA_VIEWS[0])),
                terminal,
            )
        neutral, in_styles = looks["neutral"], {style: looks[style] for style in styles}
        if renders:
            in_a_row = neutral, *in_styles.values()
            rows = [[tile(rendered(trained, look, photo), TILE_PX) for look in in_a_row] for photo in seen_from]
        elif grid:
            rows = grid_of(in_styles, trained, seen_from[0])
        else:
            rows = sheet(trained, neutral, in_styles, seen_from[0])
        write_rows(output, rows, terminal)
        for style, look in in_styles.items():
            if line := nearness(trained, style, look):
                terminal.say(line)


def grid_of(looks: dict[str, Look], trained: TrainedRun, photo: Photo) -> list[list[np.ndarray]]:
    """Rows of three: the looks from the camera of `photo`, each with the photo that it was read from in a corner."""
    pictures = {word: tile(rendered(trained, look, photo), LARGE_PX) for word, look in looks.items()}
    shown = [
        picture if word == "neutral" else with_inset(picture, source(trained, word))
        for word, picture in pictures.items()
    ]
    return [shown[first : first + 3] for first in range(0, len(shown), 3)]


def sheet(trained: TrainedRun, neutral: Look, in_styles: dict[str, Look], photo: Photo) -> list[list[np.ndarray]]:
    """Rows of pictures: one for each style photo with its look,
    then a strip of looks from that of the first photo to that of the last."""
    looks, rows = list(in_styles.values()), []
    for style, look in in_styles.items():
        row = [read_pixels(Path(style)), *(rendered(trained, shown, photo) for shown in (neutral, look))]
        truth = truths(trained, style).get(photo.name)
        rows.append([tile(picture, TILE_PX) for picture in (row if truth is None else [*row, read_pixels(truth)])])
    first = looks[0] if len(looks) > 1 else neutral
    strip = [rendered(trained, blend(first, looks[-1], share), photo) for share in np.linspace(0, 1, FRAMES)]
    width = max(sum(picture.shape[1] for picture in row) for row in rows)
    height = min(TILE_PX, width // FRAMES * strip[0].shape[0] // strip[0].shape[1])
    return [*rows, [tile(frame, height) for frame in strip]]


def rendered(trained: TrainedRun, look: Look, photo: Photo) -> np.ndarray:
    """A look from the camera of a photo, 8 bit."""
    return to_8_bit(drawn(trained, bake(trained, look), trained.camera(photo)))


def tile(picture: np.ndarray, height: int) -> np.ndarray:
    """The picture at a height in pixels."""
    width = round(picture.shape[1] * height / picture.shape[0])
    shrinks = height < picture.shape[0]
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC)


def source(trained: TrainedRun, word: str) -> np.ndarray:
    """The photo of a look: one of the run, by name, or a file."""
    photo = trained.collection.called(word)
    return read_pixels(Path(word) if photo is None else photo.path)


def with_inset(picture: np.ndarray, photo: np.ndarray) -> np.ndarray:
    """The picture with the photo, small and framed in white, in its lower left corner."""
    small = np.pad(
        tile(photo, round(INSET * len(picture))), ((FRAME_PX,) * 2, (FRAME_PX,) * 2, (0, 0)), constant_values=255
    )
    shown = picture.copy()
    shown[-len(small) :, : small.shape[1]] = small
    return shown


def write_rows(path: Path, rows: list[list[np.ndarray]], report: Report) -> None:
    """Write the rows one below the other as a JPEG; shorter ones are padded with white."""
    width = max(sum(picture.shape[1] for picture in row) for row in rows)
    lines = [np.concatenate(row, axis=1) for row in rows]
    canvas = [np.pad(line, ((0, 0), (0, width - line.shape[1]), (0, 0)), constant_values=255) for line in lines]
    write_jpeg(path, np.concatenate(canvas), report)


def truths(trained: TrainedRun, style: str) -> dict[str, Path]:
    """The true pictures of a synthetic scene in the light of one of its style photos,
    by the name of the photo whose view they show; none for another photo, whatever it is called."""
    own, root = Path(style), trained.collection.root
    of_scene = root / "styles" / own.name
    if not (own.is_file() and of_scene.is_file() and cmp(own, of_scene, shallow=False)):
        return {}
    known = {Path(photo.name).stem: photo.name for photo in trained.collection.photos}
    folder = root / "truth" / "styles" / own.stem
    return {known[path.stem]: path for path in sorted(folder.glob("*.png")) if path.stem in known}


def nearness(trained: TrainedRun, style: str, own: Look) -> str | None:
    """In words, how close the look of a style photo comes to the true pictures in its light;
    None if these are unknown."""
    true = {name: true_view(trained, name, path) for name, path in truths(trained, style).items()}
    if not true:
        return None
    seen = {photo.name: look_of_photo(trained, photo, refine=False) for photo in trained.collection.split("train")}
    looks = {"own": own, "read": find_look(trained, style, refine=False), "neutral": neutral_look(trained)} | seen
    found: dict[str, list[float]] = {}
    for which, look in looks.items():
        baked = bake(trained, look)
        found[which] = [decibels(trained, baked, *view) for view in true.values()]
    if trained.has_looks:
        fitted = (bake(trained, refined(trained, own, *view, None)) for view in true.values())
        found["fitted"] = [decibels(trained, baked, *view) for baked, view in zip(fitted, true.values(), strict=True)]
    means = {which: sum(values) / len(values) for which, values in found.items()}
    nearest = max(seen, key=means.__getitem__)
    return (
        f"{Path(style).name}: {means['own']:.2f} dB from the truth in {counted(len(true), 'view')}, "
        f"zero-shot {means['read']:.2f}; the nearest of "
        f"{counted(len(seen), 'look')} of training photos ({nearest}) {means[nearest]:.2f}, "
        f"neutral {means['neutral']:.2f}, "
        f"fitted to the truth {means.get('fitted', means['own']):.2f}"
    )


def true_view(trained: TrainedRun, name: str, path: Path) -> tuple[Camera, Float[Tensor, "h w 3"]]:
    """The camera of the photo called `name`, and the true picture that it sees."""
    camera = trained.camera(trained.collection.photo(name))
    pixels = cv2.resize(read_pixels(path), (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return camera, torch.from_numpy(pixels).to(trained.device).float() / 255


def decibels(trained: TrainedRun, baked: Splats, camera: Camera, truth: Float[Tensor, "h w 3"]) -> float:
    """PSNR of the run in a look that is baked, as the camera sees it."""
    return metrics.psnr(metrics.quantised(drawn(trained, baked, camera)), truth)


if __name__ == "__main__":
    main()
