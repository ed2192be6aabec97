"""Cameras of plain photos, found once: structure from motion takes minutes, and its result is kept beside the runs."""

from contextlib import suppress
from pathlib import Path

from core.data import sfm, sfm_record
from core.data.colmap import find_model
from core.data.load import kind_with_cameras
from core.data.made import made_once, read_mark
from core.errors import BadInput
from core.report import Report


def scene_around(photos: Path) -> tuple[Path, str] | None:
    """The scene with cameras that the folder `photos` lies in, and its kind; None for none.

    Where that is the dense/ of a PhotoTourism scene, the whole is meant, which holds the split.
    """
    above = photos.resolve().parent
    for scene in (above.parent, above):
        with suppress(BadInput):  # parts of a model are no cameras
            kind = kind_with_cameras(scene)
            if kind and (scene == above or (find_model(scene) or scene).is_relative_to(above)):
                return scene, kind
    return None


def scene_of_photos(photos: Path, wanted: Path, report: Report) -> Path:
    """Where the COLMAP scene of the photos in the folder `photos` lies; it is made now unless it is there already.

    wanted: where it should lie; if another scene does, a number is added. A scene that is there is used again only for
    the very same files (path, size and time of change of each). Errors: as sfm.reconstruct.
    """
    made_of = sfm_record.files_of(photos)

    def make(scene: Path) -> None:
        if around := scene_around(photos):
            report.warn(f"{around[0]} is a {around[1]} scene: give that folder to use its cameras. Now they are found anew.")
        sfm.reconstruct(photos, scene, report)

    return made_once(wanted, lambda folder: read_mark(folder / sfm_record.FILES) == made_of, make, "Cameras as found", report)
