"""COLMAP folders: a model and the photos that it was made from, at whatever size."""

import os
from collections import Counter
from copy import copy
from pathlib import Path

import numpy as np
import pycolmap

from core.data.formats.model_file import holds_model, lacking_files, photos_in_model, point_table, read_model
from core.data.found_file import SHRUNKEN, nearly_named, with_files_found
from core.data.photos.folder import list_photos
from core.data.photos.names import is_file, relative_path
from core.data.posed import LARGEST_COORDINATE, Points, Posed, PosedPhoto, usable_points
from core.errors import BadInput
from core.words import Note, name_them

MODEL_FOLDERS = ("sparse/0", "sparse", "dense/sparse/0", "dense/sparse", "dense/0/sparse")
NERFSTUDIO_FOLDER = "colmap/sparse/0"
# Made of the model in that folder; it says more, but not which photo sees which point.
NERFSTUDIO_FILE = "transforms.json"
LENGTH_SLACK = 1e-9  # of a quaternion; pycolmap relies on a length of 1
# Where photos may lie that were not undistorted yet: a model of undistorted ones has other pixels.
ORIGINALS = ("input", "photos")


def find_model(root: Path) -> Path | None:
    """The folder of the COLMAP model: below `root`, or `root` itself if it also holds the photos; else None.
    BadInput if the model lacks files."""
    folders = [root / name for name in MODEL_FOLDERS]
    folders += [folder for base in ("sparse", "dense/sparse") for folder in _numbered(root / base)]
    if not (root / NERFSTUDIO_FILE).exists():
        folders.append(root / NERFSTUDIO_FOLDER)
    if models := [folder for folder in folders if holds_model(folder)]:
        folder = next((folder for folder in models if _has_photos(root, folder)), models[0])
        others = _models_beside(folder)
        return max([folder, *others], key=photos_in_model) if others else folder  # the first of equals
    for folder in folders:
        if lacking := lacking_files(folder):
            fix = "Copy it again, or remove the folder to have the cameras found anew."
            raise BadInput(f"The COLMAP model in {folder} lacks {', '.join(lacking)}.", fix)
    return root if holds_model(root) and ((root / "images").is_dir() or list_photos(root)) else None


def lacks_photos(folder: Path) -> bool:
    """Whether the folder holds a COLMAP model or several, but no whole scene, as the photos lie elsewhere."""
    return any(holds_model(path) for path in (folder, *_numbered(folder)))


def _numbered(folder: Path) -> list[Path]:
    """The models 0, 1, ... that COLMAP writes when the photos fall apart into several;
    their numbers do not follow their size."""
    found = [path for path in folder.iterdir() if path.name.isdecimal()] if folder.is_dir() else []
    return sorted(found, key=lambda path: int(path.name))


def _models_beside(model: Path) -> list[Path]:
    """The other numbered models in its folder; none for a model without a number."""
    if not model.name.isdecimal():
        return []
    return [folder for folder in _numbered(model.parent) if folder != model and holds_model(folder)]


def nerfstudio_models(root: Path) -> list[Path]:
    """The folders of the models, or parts of them, that nerfstudio left below `root`, that of most photos first."""
    found = _numbered((root / NERFSTUDIO_FOLDER).parent)
    return sorted(
        (folder for folder in found if holds_model(folder) or lacking_files(folder)), key=photos_in_model, reverse=True
    )


def read_colmap(root: Path) -> Posed:
    """What the COLMAP model below `root` says of its photos, which lie in images/, images_N/ or beside it.

    Raises BadInput for a damaged model, and for one without poses.
    """
    model = find_model(root)
    if model is None:
        raise BadInput(f"{root} has no COLMAP model any more.", "Put it back.")
    reconstruction = read_model(model)
    names, garbled = names_in(reconstruction)
    not_named = name_them("of the model whose name is not in UTF-8, not used", garbled)
    found = [
        image for number in sorted(names, key=names.__getitem__) if (image := reconstruction.images[number]).has_pose
    ]
    if not found:
        why = f": {not_named[0].text}" if not_named else ""
        raise BadInput(
            f"{model} has no photos with a pose{why}.", "Run COLMAP again, or type: wegs sfm PHOTOS -o SCENE"
        )
    points, notes = read_points(reconstruction, model)
    notes += not_named + _other_models(model)
    images = _images_folder(root, model, [image.name for image in found])
    if images.name in ORIGINALS:
        right = "which are right unless it is one of undistorted photos"
        notes.append(Note(f"No photos of the model in images/: those in {images} are used, {right}."))
    if images.name in SHRUNKEN:
        fuller = images.parent / "images"
        why = f"{fuller} holds less than half of the model's" if fuller.is_dir() else f"there is no {fuller}"
        notes.append(Note(f"The photos in {images} are used: {why}.", harmless=True))
    names_used = Counter(image.name for image in found)
    notes += name_them(
        "of the model named more than once, used once", [name for name, times in names_used.items() if times > 1]
    )
    photos, found_notes = with_files_found([posed_photo(reconstruction, image, images) for image in found], [images])
    notes += found_notes
    there = list_photos(images) if images.is_dir() else []  # not where a model names its photos by whole paths
    known = {
        os.path.abspath(path) for path in (*(photo.path for photo in photos), *(images / name for name in garbled))
    }
    extra = [path.name for path in there if os.path.abspath(path) not in known]
    notes += name_them(f"in {images} without a pose, not used", extra)
    fix = f"Put the photos into {root / 'images'}, named as in the model."
    return Posed("colmap", model, photos, points, f"of the model missing in {images}", fix, notes)


def names_in(reconstruction: pycolmap.Reconstruction) -> tuple[dict[int, str], list[str]]:
    """The names of a model's photos, by id; and those that are not UTF-8, which pycolmap refuses to return,
    as Python spells such file names."""
    names, garbled = {}, []
    for number, image in reconstruction.images.items():
        try:
            names[number] = image.name
        except UnicodeDecodeError as problem:
            garbled.append(problem.object.decode("utf-8", "surrogateescape"))
    return names, sorted(garbled)


def posed_photo(model: pycolmap.Reconstruction, image: pycolmap.Image, images: Path) -> PosedPhoto:
    """What the model says of one of its images, whose photo lies in the folder `images`."""
    pose = image.cam_from_world()
    camera = copy(model.cameras[image.camera_id])  # the model's own is freed with the model
    # A photo with an impossible pose is left out later, by core.data.placing.
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.linalg.norm(pose.rotation.quat)
        if abs(length - 1) > LENGTH_SLACK:
            pose.rotation = pycolmap.Rotation3d(
                pose.rotation.quat / length if 0 < length < LARGEST_COORDINATE else np.full(4, np.nan)
            )
        rotation, translation = pose.rotation.matrix(), pose.translation
        centre = -rotation.T @ translation
    return PosedPhoto(image.name, images / image.name, lambda width, height: camera, rotation, centre)


def read_points(reconstruction: pycolmap.Reconstruction, model: Path) -> tuple[Points | None, list[Note]]:
    """The usable points of a model, if any, with which photo sees which, if the model says so; and notes."""
    table = point_table(reconstruction, model)
    good, notes = usable_points(table.positions)
    if not len(good) and any(image.num_points3D for image in reconstruction.images.values()):
        notes.append(Note(f"{model} lacks the points that its photos see: copy it again if you have them."))
    if not good.any():
        return None, notes
    positions, colours = table.positions[good], table.colours[good].astype(np.float32) / 255
    row_of = np.cumsum(good) - 1
    kept = good[table.observed]
    observers, observed = table.observers[kept], row_of[table.observed[kept]]
    if not len(observers):  # some programs write no tracks, others none that fit
        observers, observed = _as_photos_say(reconstruction, table.ids[good])
        if not len(observers):
            return Points(positions, colours, None), notes
        notes.append(Note(f"The points of {model} do not say which of its photos see them: its photos do."))
    order = np.argsort(observers, kind="stable")
    observers, observed = observers[order], observed[order]
    names = names_in(reconstruction)[0]
    starts, ends = (np.searchsorted(observers, list(names), side) for side in ("left", "right"))
    # An image may see a point twice.
    seen = {name: np.unique(observed[start:end]) for name, start, end in zip(names.values(), starts, ends, strict=True)}
    return Points(positions, colours, seen), notes


def _as_photos_say(reconstruction: pycolmap.Reconstruction, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """PointTable.observers and .observed of the points with these ids (P,), ascending,
    from what the photos say of their features."""
    observers, observed = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for number, image in reconstruction.images.items():
        said = np.fromiter((feature.point3D_id for feature in image.get_observation_points2D()), ids.dtype)
        rows = np.searchsorted(ids, said).clip(max=len(ids) - 1)
        observed.append(rows[ids[rows] == said])
        observers.append(np.full(len(observed[-1]), number))
    return np.concatenate(observers), np.concatenate(observed)


def _other_models(model: Path) -> list[Note]:
    others = ", ".join(folder.name for folder in _models_beside(model))
    if not others:
        return []
    return [Note(f"{model.parent} holds other models as well ({others}); {model.name} is used: it has most photos.")]


def _bases(root: Path, model: Path) -> list[Path]:
    """The folders in which the photos of the model, or folders of photos, may lie. The nearest comes first: farther
    ones may hold the originals of undistorted photos."""
    return [model.parent.parent if model.name.isdecimal() else model.parent, root]


def _has_photos(root: Path, model: Path) -> bool:
    """Whether there are photos for the model: COLMAP's workspaces also hold models without, beside the undistorted
    scenes made from them. Loose pictures count as photos if they are at least half as many as the model has, otherwise
    as previews."""
    bases, enough = _bases(root, model), max(1, photos_in_model(model) / 2)
    has_folder = any((base / name).is_dir() for base in bases for name in ("images", *SHRUNKEN, *ORIGINALS))
    return has_folder or any(len(list_photos(base)) >= enough for base in bases)


def _images_folder(root: Path, model: Path, names: list[str]) -> Path:
    """The first folder with at least half of the model's photos, or else the one with most: images/ or images_N/ in one
    of the bases, or a base itself; input/ or photos/ only if none of these holds any. Half is enough so that the
    smaller copies are not used as soon as somebody takes a photo out of images/.
    """
    bases = _bases(root, model)
    usual = [base / name for base in bases for name in ("images", *SHRUNKEN)] + bases
    originals = [base / name for base in bases for name in ORIGINALS]

    def exact(folder: Path) -> int:
        return sum(is_file(folder / name) for name in names)

    def alike(folder: Path) -> int:
        return len(nearly_named({folder / name: [folder, folder / relative_path(name).parent] for name in names}))

    for folders, count in ((usual, exact), (usual, alike), (originals, exact), (originals, alike)):
        counts = {}
        for folder in folders:
            counts[folder] = count(folder)
            if 2 * counts[folder] >= len(names):
                return folder
        most = max(counts, key=counts.__getitem__)  # the first of equals
        if counts[most]:
            return most
    return usual[0]
