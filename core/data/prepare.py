"""Makes what a scene lacks for training, cameras for plain photos and points for posed ones,
and keeps it beside the runs for the next one."""

from pathlib import Path

from core.config import Settings
from core.data.collection import Collection
from core.data.given_masks import with_masks_in
from core.data.load import find_kind, find_photos, load_collection, scene_around, warn_of_others
from core.data.made import made_once
from core.data.sfm import originals
from core.data.sfm.kept_points import points_beside
from core.data.sfm.reconstruct import reconstruct
from core.data.split import copy_lists
from core.data.transparency import transparent_may_be_empty
from core.report import Report

DEFAULTS = Settings()


def prepared(
    scene: Path, wanted: Path, report: Report, settings: Settings = DEFAULTS, masks: Path | None = None
) -> Collection:
    """The collection in the folder `scene`; what it lacks is made now, unless it was made before.

    wanted: the folder for what is made, from which the collection is then read; nothing is written into the scene.
    masks: a folder of them, as in `with_masks_in`. Errors as in load_collection, with_masks_in and structure from
    motion.
    """
    plain = find_kind(scene) == "photos"
    if plain:
        scene = _with_cameras(scene, wanted, report)
    if words := originals.shortfall(scene):
        report.warn(words)

    def read(folder: Path) -> Collection:
        collection = load_collection(folder, settings.all_photos)
        return collection if masks is None else with_masks_in(collection, masks)

    collection = read(scene)
    if plain or len(collection.points):
        return collection
    return read(points_beside(collection, transparent_may_be_empty(collection, settings), wanted, report))


def _with_cameras(scene: Path, wanted: Path, report: Report) -> Path:
    """The COLMAP scene made of the plain photos in the folder `scene`."""
    photos = find_photos(scene)
    warn_of_others(scene, photos, report)
    made = scene_of_photos(photos, wanted, report)
    copy_lists((photos, scene), made)
    return made


def scene_of_photos(photos: Path, wanted: Path, report: Report) -> Path:
    """The folder of the COLMAP scene made of the photos in the folder `photos`, which is made now unless it exists.

    wanted: the name of the folder, to which a number is added if another scene has it. A scene is used again only for
    the very same files (name, size and modification time of each). Errors: as `reconstruct`.
    """
    files = originals.files_of(photos)

    def is_of_these(scene: Path) -> bool:
        return originals.is_made_of(scene, files)

    def make(scene: Path) -> None:
        if around := scene_around(photos):
            report.warn(
                f"{around[0]} is a {around[1]} scene: give that folder to use its cameras. Now they are found anew."
            )
        reconstruct(photos, scene, report)

    return made_once(wanted, originals.MADE_OF, is_of_these, make, "Cameras as found", report)
