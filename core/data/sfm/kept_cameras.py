"""Cameras of plain photos, found once: structure from motion takes minutes, so its result is kept beside the runs."""

from pathlib import Path

from core.data.load import scene_around
from core.data.made import made_once
from core.data.sfm import originals
from core.data.sfm.reconstruct import reconstruct
from core.report import Report


def scene_of_photos(photos: Path, wanted: Path, report: Report) -> Path:
    """The folder of the COLMAP scene made of the photos in the folder `photos`, which is made now unless it exists.

    wanted: the name of the folder, to which a number is added if another scene has it. A scene is used again only for
    the very same files (name, size and modification time of each). Errors: as `reconstruct`.
    """
    files = originals.files_of(photos)

    def make(scene: Path) -> None:
        if around := scene_around(photos):
            report.warn(
                f"{around[0]} is a {around[1]} scene: give that folder to use its cameras. Now they are found anew."
            )
        reconstruct(photos, scene, report)

    return made_once(
        wanted, originals.MADE_OF, lambda folder: originals.is_made_of(folder, files), make, "Cameras as found", report
    )
