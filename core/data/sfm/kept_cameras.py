"""Cameras of plain photos are found once: structure from motion takes minutes, so its result is kept beside the runs."""

from contextlib import suppress
from pathlib import Path

from core.data.formats.colmap import find_model
from core.data.load import kind_with_cameras
from core.data.made import made_once
from core.data.sfm import originals
from core.data.sfm.reconstruct import reconstruct
from core.errors import BadInput
from core.report import Report


def scene_around(photos: Path) -> tuple[Path, str] | None:
    """The scene with cameras that the folder `photos` lies in, and its kind; None if there is none.

    Inside the dense/ of a PhotoTourism scene, that is the folder above dense/, which holds the split.
    """
    above = photos.resolve().parent
    for scene in (above.parent, above):
        with suppress(BadInput):  # half a model is no scene
            kind = kind_with_cameras(scene)
            if kind and (scene == above or (find_model(scene) or scene).is_relative_to(above)):
                return scene, kind
    return None


def scene_of_photos(photos: Path, wanted: Path, report: Report) -> Path:
    """The folder of the COLMAP scene made of the photos in the folder `photos`, which is made now unless it exists.

    wanted: the folder; with a number if another scene has it. A scene is used again only for the very same files (name, size and
    modification time of each). Errors: as `reconstruct`.
    """
    files = originals.files_of(photos)

    def make(scene: Path) -> None:
        if around := scene_around(photos):
            report.warn(f"{around[0]} is a {around[1]} scene: give that folder to use its cameras. Now they are found anew.")
        reconstruct(photos, scene, report)

    return made_once(wanted, originals.MADE_OF, lambda folder: originals.is_made_of(folder, files), make, "Cameras as found", report)
