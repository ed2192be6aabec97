"""What extreme coordinates, wrong cameras and blank photos cost in quality:
spoilt copies of samples/plaza, and plaza as it is.

    python samples/stiff.py --seeds 3

Each case is a copy of the scene with a changed model or changed photos, trained like any other scene. Prints the
zero-shot PSNR (dB) of the held-out photos by protocol `full`: the mean over the seeds and its standard deviation. What
is finished in the output folder is neither trained nor measured again; runs there with other settings are replaced.
"""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from samples.measurements.begin import begin

begin()

import click
import cv2
import numpy as np
import pycolmap

from core.data.split_table import read_split_table
from core.system.outputs import check_folder
from samples.measurements import arguments, markdown
from samples.measurements.finished import measured
from samples.measurements.seeds import cell, folder_name
from wegs_cli.main import OneLineErrors
from wegs_cli.terminal import Terminal

SCENE = Path(__file__).parent / "plaza"
# Of a model and the files of its training photos, in place.
Change = Callable[[pycolmap.Reconstruction, list[Path]], None]


def moved(scale: float, offset: float) -> Change:
    """The whole model in another unit, and elsewhere."""

    def change(model: pycolmap.Reconstruction, _) -> None:
        model.transform(pycolmap.Sim3d(scale, pycolmap.Rotation3d(), np.array([offset, -offset, offset])))

    return change


def wrong_cameras(model: pycolmap.Reconstruction, photos: list[Path]) -> None:
    """One training photo with a focal length of 3e6 px, another a million units off."""
    first, second = (model.find_image_with_name(path.name) for path in photos[:2])
    camera = model.cameras[first.camera_id]
    camera.params = [3e6, 3e6, *camera.params[2:]]
    pose = second.cam_from_world()
    far = pycolmap.Rigid3d(pose.rotation, pose.translation + 1e6)
    model.frame(second.frame_id).set_cam_from_world(second.camera_id, far)


def black_and_white(_, photos: list[Path]) -> None:
    """One training photo all black, another all white."""
    for path, level in zip(photos, (0, 255)):
        cv2.imwrite(str(path), np.full_like(cv2.imread(str(path)), level))


CASES: dict[str, Change] = {
    "as it is": lambda *_: None,
    "coordinates at 5e5": moved(1.0, 5e5),
    "coordinates at 5e6": moved(1.0, 5e6),
    "scene x 1e-4": moved(1e-4, 0.0),
    "scene x 1e4": moved(1e4, 0.0),
    "two wrong cameras": wrong_cameras,
    "a black and a white photo": black_and_white,
}


@click.command(cls=OneLineErrors)
@arguments.steps(500)
@arguments.resolution(4)
@arguments.seeds(3, "Runs of each case.")
@arguments.output("runs/stiff")
def main(steps: int, resolution: int, seeds: int, output: Path) -> None:
    """Train and measure every case; prints a Markdown table."""
    check_folder(output)
    rows = []
    with Terminal() as terminal:
        for name, change in CASES.items():
            folder = output / folder_name(name)
            scene = spoilt(folder / "scene", change)
            figures = []
            for seed in range(seeds):
                settings = arguments.settings_of("quick", steps, resolution=resolution, seed=seed, held_out_checks=0)
                found = measured(scene, settings, folder / f"seed{seed}", ["full"], terminal)
                figures.append(found["results"]["full"]["means"]["photo"]["zero_shot"]["psnr"])
            rows.append((name, cell(figures, "{:.2f}")))
    click.echo(markdown.table(("case", "PSNR"), rows))


def spoilt(folder: Path, change: Change) -> Path:
    """A copy of plaza with its model and training photos changed, in place of one that an earlier run left: that may be
    incomplete, or of another plaza."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(SCENE / "dense", folder / "dense")
    shutil.copy(SCENE / "plaza.tsv", folder)
    splits = read_split_table(SCENE / "plaza.tsv").splits
    photos = [folder / "dense" / "images" / name for name, split in splits.items() if split == "train"]
    model = pycolmap.Reconstruction(folder / "dense" / "sparse")
    change(model, photos)
    model.write(folder / "dense" / "sparse")
    return folder


if __name__ == "__main__":
    main()
