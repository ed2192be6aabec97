"""What a scene lacks for training is made once and kept beside the runs: cameras of plain photos, points of posed ones."""

from pathlib import Path

from core.data.collection import Collection
from core.data.found_cameras import scene_of_photos
from core.data.kept_points import points_beside
from core.data.load import POSED, find_kind, find_photos, load_collection
from core.report import Report


def prepared(scene: Path, wanted: Path, report: Report) -> Collection:
    """The collection in the folder `scene`, with what it lacks made now unless it was made before.

    wanted: where what is made should lie; it is the collection's root then. Nothing is written into the scene. Errors: as of
    structure from motion, and of reading.
    """
    if find_kind(scene) == "photos":
        return load_collection(scene_of_photos(find_photos(scene), wanted, report))
    collection = load_collection(scene)
    if len(collection.points) or collection.kind not in POSED:
        return collection
    return load_collection(points_beside(collection, wanted, report))
