"""From a folder to a Collection: finds out what kind it is and reads it."""

from pathlib import Path

from core.data.collection import Collection
from core.data.colmap import find_model, load_colmap
from core.data.model_file import holds_model
from core.data.photo_file import list_photos, no_photos
from core.data.phototourism import find_split_tables
from core.errors import BadInput, command

PHOTO_FOLDERS = (".", "images", "photos")
NOT_READ_YET = {
    "transforms.json": "a nerfstudio scene",
    "transforms_train.json": "a Blender scene",
    "final/train/pose": "a NeRF-OSR scene",
}


def load_collection(path: Path) -> Collection:
    """The posed photos in the folder `path`, a COLMAP or PhotoTourism scene.

    Raises BadInput where there is no such folder, no photos, no model, or nothing usable in them; photos that cannot be
    used while others can are left out and named in the collection's notes.
    """
    path = Path(path)
    kind = find_kind(path)
    if kind == "photos":
        scene = path.resolve().name + "-scene"
        raise BadInput(
            f"{path} holds photos but no COLMAP model.", f"Type: {command('wegs', 'sfm', path, '-o', scene)}"
        )
    return load_colmap(path, find_model(path), kind)


def find_kind(path: Path) -> str:
    """What a folder holds: "phototourism" (a COLMAP model and a split .tsv), "colmap", or "photos" (without any poses).

    Raises BadInput for anything else, and names the kinds that are not read yet. A model beats a transforms.json.
    """
    if not path.exists():
        raise BadInput(f"There is no folder {path}.", "Give the folder that holds your photos.")
    if not path.is_dir():
        raise BadInput(f"{path} is a file, not a folder.", "Give the folder that holds your photos.")
    if find_model(path):
        return "phototourism" if find_split_tables(path) else "colmap"
    for mark, name in NOT_READ_YET.items():
        if (path / mark).exists():
            raise BadInput(
                f"{path} looks like {name} ({mark}), which is not read yet.", "Give a COLMAP scene, or photos."
            )
    find_photos(path)
    return "photos"


def find_photos(path: Path) -> Path:
    """The folder of plain photos: `path`, or images/ or photos/ in it. Raises BadInput where there are none."""
    for name in PHOTO_FOLDERS:
        if (path / name).is_dir() and list_photos(path / name):
            return path / name
    if holds_model(path):
        fix = "Give the folder above it that holds the photos as well."
        raise BadInput(f"{path} holds a COLMAP model, but not the photos it was made from.", fix)
    raise no_photos(path, "no photos and no COLMAP model")
