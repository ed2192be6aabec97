"""Makes what a scene lacks for training, cameras for plain photos and points for posed ones,
and keeps it beside the runs for the next one."""

from pathlib import Path

from core.data.collection import Collection
from core.data.load import find_kind, find_photos, load_collection, warn_of_others
from core.data.sfm.kept_cameras import scene_of_photos
from core.data.sfm.kept_points import points_beside
from core.data.sfm.originals import shortfall
from core.data.split import copy_lists
from core.report import Report


def prepared(scene: Path, wanted: Path, report: Report, all_photos: bool = False) -> Collection:
    """The collection in the folder `scene`; what it lacks is made now, unless it was made before.

    wanted: the folder for what is made, from which the collection is then read; nothing is written into the scene.
    all_photos, errors: as in load_collection; errors also as in structure from motion.
    """
    plain = find_kind(scene) == "photos"
    if plain:
        scene = _with_cameras(scene, wanted, report)
    if words := shortfall(scene):
        report.warn(words)
    collection = load_collection(scene, all_photos)
    if plain or len(collection.points):
        return collection
    return load_collection(points_beside(collection, wanted, report), all_photos)


def _with_cameras(scene: Path, wanted: Path, report: Report) -> Path:
    """The COLMAP scene made of the plain photos in the folder `scene`."""
    photos = find_photos(scene)
    warn_of_others(scene, photos, report)
    made = scene_of_photos(photos, wanted, report)
    copy_lists((photos, scene), made)
    return made
