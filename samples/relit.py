"""What a look shows from where its photo was not taken: the scene in the light of one photo, seen by other cameras.

    python samples/relit.py RUN

RUN (default: the newest) was trained on samples/plaza, or on another collection that `make_plaza.py` made. The look of
each held-out photo is read from the whole photo, and refined. It is scored against the empty square, ray-cast in the
same light, as seen by: the photo's own camera; that camera moved by some metres to where no photo was taken; the three
cameras of other photos with the most similar view; and three spread over all others. Prints the PSNR of each photo and
a table of the means.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from samples.measurements.begin import begin

begin()

import click
import cv2
import numpy as np
import torch
from jaxtyping import Float

from core.appearance.colouring import Colouring
from core.data.collection import Photo, spread_over
from core.errors import BadInput
from core.evaluation.metrics import psnr, quantised
from core.evaluation.protocols import fit_of, refined
from core.evaluation.truth import FOLDER
from core.looks.held_out_views import held_out_view
from core.looks.trained import TrainedRun
from core.scene.camera import Camera
from samples.measurements import arguments, markdown
from samples.measurements.opened import opened
from samples.plaza_maker.cameras import View
from samples.plaza_maker.light import render
from samples.plaza_maker.looks import Look, develop
from samples.plaza_maker.rays import World
from samples.plaza_maker.square import static_groups
from wegs_cli.main import OneLineErrors
from wegs_cli.terminal import Terminal

CAMERAS = 3  # of other photos, of each kind
TURN_M = 20.0  # metres that tell views apart as much as a turn of 90 degrees
STEPS_M = (3.0, 8.0)  # from the photo's own camera
WAYS = np.array([(1, 0, 0), (-1, 0, 0), (0, -1, 0), (0, 0, 1)])  # right, left, up and forward, as the camera sees it
KINDS = (
    "its own",
    *(f"{step:.0f} m aside, above or ahead" for step in STEPS_M),
    "three that see most alike",
    "three of the others",
)


@dataclass(frozen=True)
class Standpoint:
    """Where the scene is looked at from. camera: in the scene frame; view:
    the true one, in metres and at the photo's full size."""

    camera: Camera
    view: View


@click.command(cls=OneLineErrors)
@arguments.run
@arguments.count("--grid", 2, "Sub-samples per pixel of the truth along each side.")
def main(run_folder: Path | None, grid: int) -> None:
    """Score the looks of RUN's held-out photos as other cameras see them."""
    trained, held_out = opened(run_folder)
    record = trained.collection.root / FOLDER / "looks.json"
    if not record.is_file():
        raise BadInput(
            f"{trained.folder} is of a scene whose lights are not known: there is no {record}.",
            "Take a run of samples/plaza.",
        )
    truth = json.loads(record.read_text())
    metre = truth["model"]["scale"] / trained.collection.frame.radius  # in scene units
    taken = {photo.name: truth["photos"][Path(photo.name).stem] for photo in trained.collection.photos}
    world, scored = World(static_groups()), []
    with Terminal() as terminal:
        for done, photo in enumerate(held_out, 1):
            light = Look(**taken[photo.name]["look"])
            looks = looks_of(trained, photo)
            own, *others = (
                [standpoint(trained, name, taken[name]["camera"]) for name in names]
                for names in cameras_beside(photo.name, taken)
            )
            kinds = [own, *(moved(own[0], step, metre) for step in STEPS_M), *others]
            scored.append(
                [
                    np.mean([scores(trained, looks, place, light, world, grid) for place in kind], axis=0)
                    for kind in kinds
                ]
            )
            figures = "; ".join(
                f"{kind} {zero_shot:.2f}, {refined:.2f}"
                for kind, (zero_shot, refined) in zip(KINDS, scored[-1], strict=True)
            )
            terminal.say(f"{photo.name} ({light.kind}), zero-shot and refined, dB: {figures}")
            terminal.progress("Photos", done, len(held_out))
    rows = (
        (kind, *(f"{mean:.2f}" for mean in means)) for kind, means in zip(KINDS, np.mean(scored, axis=0), strict=True)
    )
    click.echo(markdown.table(("camera", "zero-shot", "refined"), rows))


def looks_of(trained: TrainedRun, photo: Photo) -> list[Colouring]:
    """The look of a held-out photo, zero-shot and refined."""
    fit = fit_of(trained, held_out_view(trained, photo), "full")
    return [Colouring(fit.start), refined(trained, fit)]


def cameras_beside(name: str, taken: dict) -> list[list[str]]:
    """The name of the photo itself, of those whose cameras see most alike, and of some others.
    taken: what looks.json says of each photo."""

    def apart(other: str) -> float:
        first, second = (taken[each]["camera"] for each in (name, other))
        away = float(np.linalg.norm(np.subtract(first["centre"], second["centre"])))
        return away / TURN_M - np.dot(first["world_to_camera"][2], second["world_to_camera"][2])

    others = sorted((other for other in taken if other != name), key=apart)
    return [[name], others[:CAMERAS], list(spread_over(others[CAMERAS:], CAMERAS))]


def standpoint(trained: TrainedRun, name: str, taken: dict) -> Standpoint:
    """Where the photo called `name` was taken from. taken: its camera in looks.json."""
    photo = trained.collection.photo(name)
    centre, turned = (np.array(taken[part]) for part in ("centre", "world_to_camera"))
    return Standpoint(
        trained.camera(photo), View(turned, centre, taken["focal_px"], photo.camera.width, photo.camera.height)
    )


def moved(place: Standpoint, metres: float, metre: float) -> list[Standpoint]:
    """The standpoints `metres` away in each of WAYS, turned as this one is. metre: its length in scene units."""
    camera, view = place.camera, place.view
    return [
        Standpoint(
            replace(camera, centre=camera.centre + camera.world_to_camera.T @ (way * metres * metre)),
            replace(view, centre=view.centre + view.world_to_camera.T @ (way * metres)),
        )
        for way in WAYS
    ]


def scores(
    trained: TrainedRun, looks: Sequence[Colouring], place: Standpoint, light: Look, world: World, grid: int
) -> list[float]:
    """PSNR (dB) of each look, seen from a place, against the empty square in that light."""
    camera = place.camera
    whole = lit(place.view, light, world, grid)
    sized = cv2.resize(whole, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    truth = quantised(torch.from_numpy(sized).to(trained.device))
    seen = trained.seen_by(camera)
    with torch.no_grad():
        return [psnr(quantised(seen.render(look)), truth) for look in looks]


def lit(view: View, light: Look, world: World, grid: int) -> Float[np.ndarray, "h w 3"]:
    """The empty square in a light, as a camera of that view would take it."""
    return develop(light, render(world, light, view, grid).radiance)


if __name__ == "__main__":
    main()
