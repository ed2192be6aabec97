"""config.json of a run: what made it, written before the first step and read back exactly."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import core
from core.config import Settings
from core.data.collection import Collection, GivenMask, Photo
from core.data.made import CONFIG, moved_together, path_from, read_mark, relative_path_to
from core.data.photos.distortion import stated_lens
from core.data.photos.names import is_file
from core.data.sfm.kept_points import MARK, home_of
from core.data.split_table import SPLITS
from core.errors import BadInput, BadSetting
from core.run.decision import Decision
from core.scene.camera import LARGEST_PX, Camera, can_be_drawn
from core.scene.frame import SceneFrame
from core.scene.lens import Lens
from core.system.atomic import write_json

CROOKED = 1e-3  # by how much the axes of a camera may be off length 1 or right angles


class RunConfig(NamedTuple):
    """What a run was made by. identity: its name, which no run of other photos or settings has.
    collection: without SfM points, which only training needs."""

    identity: str
    settings: Settings
    collection: Collection


def write_config(folder: Path, collection: Collection, settings: Settings, decisions: Sequence[Decision] = ()) -> None:
    """Write what made the run: settings, scene, frame, photos with splits and cameras (scene frame, exact).

    The settings are those that came of the decisions, which are written for the reader: a run is never decided again.
    """
    facts: dict[str, Any] = {
        "scene": {"name": collection.name, "path": str(collection.read_from.resolve()), "kind": collection.kind},
        "frame": collection.frame.to_json(),
        "settings": settings.to_json(),
        "decisions": [asdict(decision) for decision in decisions],
        "photos": [_photo_to_json(photo, collection.root) for photo in collection.photos],
    }
    # The same photos and settings give the same embeddings: the run's name is made from them, not drawn. Of files the
    # sizes stand for the content.
    files = [path for photo in collection.photos for path in _files_of(photo).values()]
    sizes: dict[Path | None, int] = {path: path.stat().st_size for path in files if path is not None and path.is_file()}
    made_of = [core.__version__, facts, [sizes[path] for path in files if path in sizes]]
    identity = hashlib.sha256(json.dumps(made_of, sort_keys=True).encode()).hexdigest()[:12]
    facts["scene"]["from_run"] = relative_path_to(collection.read_from, folder)
    for photo, values in zip(collection.photos, facts["photos"], strict=True):
        of_photo = _files_of(photo)
        values |= {"bytes": sizes.get(of_photo["path"]), "mask_bytes": sizes.get(of_photo["mask"])}
    write_json(folder / CONFIG, {"wegs": core.__version__, "run": identity, **facts})


def read_config(folder: Path) -> RunConfig:
    """What the run's config.json says.

    Raises BadInput if config.json is damaged or of another version.
    """
    path = folder / CONFIG
    try:
        facts = json.loads(path.read_bytes())
        settings = Settings().changed(**facts["settings"])
        if undecided := settings.undecided:
            raise BadSetting(f"{undecided[0]} is left open.")
        if not facts["photos"]:
            raise ValueError("no photos")
        files = (MARK, *(photo["path"] for photo in facts["photos"]))  # of triangulated points, or of a scene
        read_from = moved_together(Path(facts["scene"]["path"]), facts["scene"].get("from_run"), folder, files)
        root = home_of(read_from)
        collection = Collection(
            name=facts["scene"]["name"],
            root=root,
            kind=facts["scene"]["kind"],
            photos=tuple(_photo_from_json(values, root) for values in facts["photos"]),
            points=np.zeros((0, 3)),
            point_colours=np.zeros((0, 3), dtype=np.float32),
            frame=SceneFrame.from_json(facts["frame"]),
            points_from=None if read_from == root else read_from,
        )
        return RunConfig(str(facts["run"]), settings, collection)
    except BadSetting as problem:
        fix = "It is of another version of wegs, or was changed: train the run again."
        raise BadInput(f"{path} cannot be used: {problem.what}", fix) from None
    except PermissionError:
        raise
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as problem:
        raise BadInput(f"{path} cannot be used: {type(problem).__name__}: {problem}.", "Train the run again.") from None


def check_same_run(folder: Path, identity: str) -> None:
    """Raise BadInput if another run than that of the identity lies in `folder` by now, or none:
    what was made of the first does not belong there."""
    if not folder.is_dir():
        raise BadInput(f"{folder} was moved or removed meanwhile.", "Run the same command again, on where it is now.")
    if (found := read_mark(folder / CONFIG).get("run")) != identity:
        what = "no run any more" if found is None else "another run than before"
        raise BadInput(f"{folder} holds {what}.", "Run the same command again.")


def changed_files(collection: Collection) -> list[str]:
    """The names of photos in whose place, or in that of whose masks, lies another file than their run began with, as
    far as sizes tell. Missing ones do not count. collection: as `read_config` gives it."""

    def is_another(file: Photo | GivenMask | None) -> bool:
        if file is None or not file.bytes or not is_file(file.path):
            return False
        return file.path.stat().st_size != file.bytes

    return [photo.name for photo in collection.photos if is_another(photo) or is_another(photo.mask)]


def scene_gone(folder: Path, collection: Collection, what: str) -> BadInput:
    """The error for a run in `folder` whose scene is no longer there. what: what therefore fails, as a clause."""
    points = collection.points_from
    where = f"{folder / CONFIG}, as its path" if points is None else f"{points / MARK}, as its scene"
    return BadInput(
        f"{what}: the scene {collection.root} is gone.", f"Move it back, or write where it is now into {where}."
    )


def _photo_to_json(photo: Photo, home: Path) -> dict:
    camera = asdict(photo.camera)
    camera |= {name: np.asarray(camera[name]).tolist() for name in ("world_to_camera", "centre")}
    files = _files_of(photo)
    ways = {key: None if path is None else path_from(home, path) for key, path in files.items()}
    outside = {key: path for key, path in files.items() if path is not None and ".." in Path(ways[key] or "").parts}
    return {
        "name": photo.name,
        **ways,
        **{f"whole_{key}": str(path.resolve()) for key, path in outside.items()},  # in case the scene alone is moved
        "split": photo.split,
        "camera": camera,
        "lens": photo.lens and asdict(photo.lens),
        "mask_lens": asdict(photo.mask.lens) if photo.mask and photo.mask.lens else None,
    }


def _files_of(photo: Photo) -> dict[str, Path | None]:
    """The photo and its mask, by their keys."""
    return {"path": photo.path, "mask": None if photo.mask is None else photo.mask.path}


def _photo_from_json(values: dict, home: Path) -> Photo:
    if not (isinstance(values["name"], str) and isinstance(values["path"], str) and values["split"] in SPLITS):
        raise ValueError(f"a photo called {values['name']!r} in {values['path']!r}, of the split {values['split']!r}")

    def file(key: str) -> Path:
        together, apart = home / values[key], values.get(f"whole_{key}")  # a whole path stays as it is
        return Path(apart) if apart and not together.is_file() and Path(apart).is_file() else together

    mask = None
    if values["mask"] is not None:
        mask = GivenMask(file("mask"), _lens_from_json(values, "mask_lens"), values.get("mask_bytes"))
    return Photo(
        name=values["name"],
        path=file("path"),
        camera=_camera_from_json(values),
        split=values["split"],
        lens=_lens_from_json(values, "lens"),
        mask=mask,
        bytes=values.get("bytes"),
    )


def _camera_from_json(photo: dict) -> Camera:
    shapes = {"world_to_camera": (3, 3), "centre": (3,)}
    values = photo["camera"] | {
        name: np.asarray(photo["camera"][name], dtype=np.float64).reshape(shape) for name, shape in shapes.items()
    }
    width, height, lens = values["width"], values["height"], [values[name] for name in ("fx", "fy", "cx", "cy")]
    are_numbers = type(width) is type(height) is int and all(type(value) in (int, float) for value in lens)
    if not (are_numbers and can_be_drawn(width, height, lens)):
        raise ValueError(f"{photo['name']} as a picture of {width}x{height} px by a camera of {lens} px")
    rotation, centre = values["world_to_camera"], values["centre"]
    are_axes = (np.abs(rotation) < 2).all() and np.abs(rotation @ rotation.T - np.eye(3)).max() < CROOKED
    if not (are_axes and np.linalg.det(rotation) > 0 and (np.abs(centre) < LARGEST_PX).all()):
        raise ValueError(f"{photo['name']} from {centre.tolist()}, turned by {rotation.tolist()}")
    return Camera(**values)


def _lens_from_json(photo: dict, key: str) -> Lens | None:
    if photo[key] is None:
        return None
    lens = stated_lens(photo[key])
    if lens is None:
        raise ValueError(f"{photo['name']} through {photo[key]}")
    return lens
