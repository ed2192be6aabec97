"""From a folder to a Collection: find out its kind, then read it."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from core.data.collect import collect
from core.data.collection import Collection
from core.data.formats.colmap import MODEL_FOLDERS, NERFSTUDIO_FILE, find_model, lacks_photos, read_colmap
from core.data.formats.model_file import holds_model, photos_in_model
from core.data.formats.nerf_osr import find_nerf_osr, read_nerf_osr
from core.data.formats.transforms import BLENDER_FILES, read_blender, read_transforms
from core.data.made import holds_run_config
from core.data.photos.folder import (
    SUFFIXES,
    VIDEO_SUFFIXES,
    folders_below,
    list_photos,
    no_photos,
    photos_below,
    take_pictures_out,
)
from core.data.posed import Posed
from core.data.sfm.kept_points import MARK, home_of, read_kept, scene_of
from core.errors import BadInput, command
from core.report import Report
from core.words import Note, counted, list_names

PHOTO_FOLDERS = (".", "images", "input", "photos")
POSED = {"colmap": read_colmap, "nerfstudio": read_transforms, "blender": read_blender, "nerf-osr": read_nerf_osr}


def load_collection(path: Path, all_photos: bool = False) -> Collection:
    """The posed photos in the folder `path`, of any kind but plain photos.

    A scene without points (most often in NeRF's formats) becomes a collection without points; core.data.prepare adds
    them. Photos that cannot be used are left out and named in the collection's notes. all_photos: hold none of them
    out. Raises BadInput if there is no such folder, or no photo with a camera in it can be used.
    """
    kind = find_kind(path)
    if kind == "photos":
        scene = path.resolve().name + "-scene"
        raise BadInput(
            f"{path} holds photos but no COLMAP model.", f"Type: {command('wegs', 'sfm', path, '-o', scene)}"
        )
    home = home_of(path)
    posed = _read(home, kind)
    if home != path:
        points, notes = read_kept(path)
        posed = replace(posed, points=points, notes=posed.notes + notes)
    return replace(collect(home, posed, all_photos), points_from=None if home == path else path)


def _read(path: Path, kind: str) -> Posed:
    posed = POSED[kind](path)
    other = posed_kind(path) if kind == "colmap" else None
    notes = [Note(f"{path} holds a {other} scene as well; its COLMAP model {posed.source} is used.")] if other else []
    return replace(posed, notes=notes + posed.notes)


def find_kind(path: Path) -> str:
    """The kind of scene in a folder: a key of POSED, or "photos" (without poses).

    A folder of triangulated points counts as the scene that they belong to. A COLMAP model takes precedence over a
    transforms.json. Raises BadInput for anything else.
    """
    check_is_folder(path)
    scene, kind = scene_of(path) or (path, None)
    if kind in POSED:
        if not scene.is_dir():
            fix = f"Move it back, or write where it is now into {path / MARK}, as its scene."
            raise BadInput(f"{path} holds the points of {scene}, which is gone.", fix)
        return kind
    if kind := kind_with_cameras(path):
        return kind
    find_photos(path)
    return "photos"


def check_is_folder(path: Path) -> None:
    """Raise BadInput unless there is such a folder; for a photo, a film or a scene's file it says what to do."""
    fix = "Give the folder that holds your photos."
    if path.is_dir():
        return
    if not path.exists():
        raise BadInput(f"There is no folder {path}.", fix)
    if path.suffix.lower() in VIDEO_SUFFIXES:
        fix = take_pictures_out(path)
    elif path.name in (NERFSTUDIO_FILE, *BLENDER_FILES.values()) or path.suffix.lower() in SUFFIXES:
        fix = f"Give the folder it is in: {path.parent}"
    raise BadInput(f"{path} is a file, not a folder.", fix)


def kind_with_cameras(path: Path) -> str | None:
    """The kind of scene with cameras that the folder holds, or None; BadInput if it holds only a part of a model."""
    try:
        return "colmap" if find_model(path) else posed_kind(path)
    except BadInput:
        if kind := posed_kind(path):
            return kind
        raise


def posed_kind(path: Path) -> str | None:
    """Which kind of scene other than COLMAP the folder holds, judged by its files, or None."""
    if (path / NERFSTUDIO_FILE).exists():
        return "nerfstudio"
    if (path / BLENDER_FILES["train"]).exists():
        return "blender"
    return "nerf-osr" if find_nerf_osr(path) else None


def scene_around(photos: Path) -> tuple[Path, str] | None:
    """The scene with cameras that the folder `photos` lies in, and its kind; None if there is none.

    Inside the dense/ of a PhotoTourism scene, and inside a split of NeRF-OSR, that is the folder above, which holds the
    split.
    """
    above = photos.resolve().parent
    for scene in (above.parent, above):
        with suppress(BadInput):  # half a model is no scene
            kind = kind_with_cameras(scene)
            split = kind == "nerf-osr" and (above / "pose").is_dir()
            if kind and (scene == above or split or (find_model(scene) or scene).is_relative_to(above)):
                return scene, kind
    return None


def check_cameras_unknown(path: Path) -> None:
    """Raise BadInput unless `path` is a folder in which structure from motion has something to do:
    not one with cameras and no plain photos."""
    check_is_folder(path)
    if (kind := kind_with_cameras(path)) and not list_photos(path):
        fix = f"Type: {command('wegs', 'train', path)} (or name the folder of its photos, to have them found anew)."
        raise BadInput(f"{path} is a {kind} scene, which has cameras.", fix)


def find_photos(path: Path) -> Path:
    """The folder of plain photos: `path`, or images/, input/ or photos/ in it, whichever holds most.
    Raises BadInput if none holds any."""
    counts = count_photos(path)
    if any(counts.values()):
        return max(counts, key=counts.__getitem__)  # the first of equals
    if lacks_photos(path):
        fix = "Give the folder above it that holds the photos as well."
        raise BadInput(f"{path} holds a COLMAP model, but not the photos it was made from.", fix)
    if scene := _scene_below(path):
        raise BadInput(
            f"{path} holds no photos and no COLMAP model; its folder {scene.relative_to(path)} is a scene.",
            "Give that folder.",
        )
    if around := scene_around(path):
        raise BadInput(
            f"{path} holds no photos and no COLMAP model; it lies in the {around[1]} scene {around[0]}.",
            "Give that folder.",
        )
    raise no_photos(path)


def _scene_below(path: Path) -> Path | None:
    """The outermost folder below `path` that is a scene with cameras and photos, or None:
    archives often wrap it in one more folder."""
    for folder in folders_below(path):
        with suppress(BadInput, OSError):  # half a model is no scene, nor is one that may not be read
            if kind_with_cameras(folder) and (list_photos(folder) or photos_below(folder)):
                return folder
    return None


def warn_of_others(path: Path, photos: Path, report: Report) -> None:
    """Warn of what lies in and below `path` but is not used:
    photos in other folders than `photos`, which `find_photos` chose, and a model."""
    for folder, count in passed_over(path, photos).items():
        report.warn(f"{counted(count, 'photo')} in {folder} not used: {photos} holds as many or more.")
    if below := not_searched(path):
        what = (
            f"{counted(sum(below.values()), 'photo')} in {list_names(list(map(str, below)))} not used: "
            "subfolders are not searched."
        )
        report.warn(f"{what} To use them, put all photos into one folder, or give theirs.")
    if model := model_elsewhere(path):
        report.warn(f"{model} holds a COLMAP model, which is not used: move it to {path / MODEL_FOLDERS[0]}.")


def model_elsewhere(path: Path) -> Path | None:
    """A folder with a COLMAP model in or below `path`, a folder of plain photos, where no model is looked for;
    of several, that of most photos."""
    return max(filter(holds_model, (path, *folders_below(path))), key=photos_in_model, default=None)


def passed_over(path: Path, photos: Path) -> dict[Path, int]:
    """The folders that `find_photos` could have chosen for `path` in place of `photos`,
    with the number of photos in each."""
    return {folder: count for folder, count in count_photos(path).items() if count and folder != photos}


def not_searched(path: Path) -> dict[Path, int]:
    """The folders below `path` that `find_photos` does not look into, with the number of photos in each."""
    places = count_photos(path)
    return {folder: count for folder, count in photos_below(path).items() if folder not in places}


def count_photos(path: Path) -> dict[Path, int]:
    """The folders that `find_photos` looks into, `path` itself and PHOTO_FOLDERS in it,
    with the number of photos in each."""
    folders = [path / name for name in PHOTO_FOLDERS]
    return {folder: len(list_photos(folder)) for folder in folders if folder.is_dir() and not holds_run_config(folder)}
