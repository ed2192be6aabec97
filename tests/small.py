"""A collection small enough to train in a test:
coloured balls seen by a ring of cameras, each photo in its own light."""

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from pytest import MonkeyPatch

from core.automatic import LEAST
from core.config import Settings
from core.data.collection import Collection, Photo
from core.data.given_masks import with_masks_in
from core.looks.trained import TrainedRun, load_run
from core.report import Report
from core.scene.camera import Camera
from core.scene.frame import SceneFrame
from core.training.trainer import Trainer

WIDTH, HEIGHT = 48, 36


def small_settings(**changes) -> Settings:
    """A run of seconds that still goes through growth, masks and coarse-to-fine;
    nothing is left to the data to decide."""
    small = {
        "steps": 40,
        "max_gaussians": 600,
        "sky_gaussians": 60,
        "densify_rounds": 4,
        "encoder_side_px": 32,
        "checkpoints": 2,
    }
    return whole_settings(**small | changes)


def whole_settings(**changes) -> Settings:
    """The defaults with a small transfer, for a scene that needs everything; on the CPU, whatever else is there."""
    small = {"device": "cpu", "embedding_size": 16, "latent_size": 0, "transfer_width": 32}
    return Settings(**small | changes).decided(
        appearance="full", transients="on", sh_degree=1, sky="dome", transparency="unseen", **LEAST
    )


def small_collection(folder: Path, photos: int = 6) -> Collection:
    """Photos written into `folder`; every third one is a test photo."""
    random = np.random.default_rng(5)
    points = random.normal(size=(200, 3)) * 0.4
    colours = random.uniform(0.1, 0.9, size=(200, 3)).astype(np.float32)
    made = []
    for index in range(photos):
        camera = ring_camera(2 * np.pi * index / photos)
        gain = 0.6 + 0.8 * index / photos
        picture = np.full((HEIGHT, WIDTH, 3), 0.5 * gain)
        pixels, depth = camera.project(points)
        for row in np.argsort(-depth):
            centre = tuple(int(x) for x in pixels[row])
            cv2.circle(picture, centre, 2, tuple(float(c) for c in colours[row] * gain), -1)
        path = folder / f"photo_{index}.png"
        cv2.imwrite(str(path), (picture[..., ::-1].clip(0, 1) * 255).astype(np.uint8))
        split = "test" if index % 3 == 2 else "train"
        made.append(Photo(path.name, path, camera, split, np.arange(len(points))))
    return Collection("small", folder, "test", tuple(made), points, colours, SceneFrame(np.zeros(3), 1.0))


def trained_to_the_end(trainer: Trainer) -> Trainer:
    """The trainer, with all its steps done."""
    for _ in trainer.train():
        pass
    return trainer


def finished(collection: Collection, settings: Settings, folder: Path) -> TrainedRun:
    """A run trained to its last step in `folder`."""
    trained_to_the_end(Trainer.of_new_run(collection, settings, folder))
    return load_run(folder)


def unfinished(run: Path) -> Path:
    """A finished run, as if it had been killed after its last step, before its last file."""
    shutil.rmtree(run / "point_cloud")
    return run


def give_to_pipeline(collection: Collection, patch: MonkeyPatch) -> None:
    """Let `core.pipeline` read this collection, whatever folder it is asked for."""

    def loaded(folder: Path, all_photos: bool = False) -> Collection:
        return collection.undivided() if all_photos else collection

    def prepared(scene: Path, wanted: Path, report: Report, settings: Settings, masks: Path | None) -> Collection:
        given = loaded(scene, settings.all_photos)
        return given if masks is None else with_masks_in(given, masks)

    patch.setattr("core.pipeline.training.load_collection", loaded)
    patch.setattr("core.pipeline.training.prepared", prepared)


def small_scene(folder: Path, patch: MonkeyPatch) -> Path:
    """Make `folder`, of which `core.pipeline` reads the small collection."""
    folder.mkdir()
    give_to_pipeline(small_collection(folder), patch)
    return folder


def ring_camera(angle: float, distance: float = 3.0) -> Camera:
    """A camera at `angle` (radians) around the y axis that looks at the origin."""
    centre = distance * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    forward = -centre / distance
    right = np.array([np.cos(angle), 0.0, np.sin(angle)])
    rotation = np.stack([right, np.array([0.0, 1.0, 0.0]), forward])
    return Camera.centred(rotation, centre, 50.0, WIDTH, HEIGHT)


def damage(photo: Photo) -> Photo:
    """The photo as a JPEG whose lower half is lost behind an end marker: seen only once it is decoded."""
    path = photo.path.with_suffix(".jpg")
    noise = np.random.default_rng(3).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    data = cv2.imencode(".jpg", noise)[1].tobytes()
    path.write_bytes(data[: len(data) // 2] + b"\xff\xd9")
    return replace(photo, path=path)
