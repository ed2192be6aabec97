"""What a scene lacks for training is made once and kept beside the runs: cameras of plain photos, points of posed ones."""

from pathlib import Path

from core.data.collection import Collection
from core.data.found_cameras import scene_of_photos
from core.data.kept_points import points_beside
from core.data.load import count_photos, find_kind, find_photos, load_collection
from core.data.split import copy_lists
from core.report import Report
from core.words import counted


def prepared(scene: Path, wanted: Path, report: Report, all_photos: bool = False) -> Collection:
    """The collection in the folder `scene`, with what it lacks made now unless it was made before.

    all_photos: as of load_collection. wanted: where what is made should lie; it is the collection's root then. Nothing is written into the scene. Errors: as of
    structure from motion, and of reading.
    """
    if find_kind(scene) == "photos":
        photos = find_photos(scene)
        for folder, count in count_photos(scene).items():
            if count and folder != photos:
                report.warn(f"{counted(count, 'photo')} in {folder} not used: {photos} holds as many or more.")
        made = scene_of_photos(photos, wanted, report)
        for folder in (photos, scene):
            copy_lists(folder, made)
        return load_collection(made, all_photos)
    collection = load_collection(scene, all_photos)
    if len(collection.points):
        return collection
    return load_collection(points_beside(collection, wanted, report), all_photos)
