"""What a scene lacks for training is made once and kept beside the runs: cameras of plain photos, points of posed ones."""

from pathlib import Path

from core.data.found_cameras import scene_of_photos
from core.data.kept_points import points_beside
from core.data.load import POSED, find_photos, load_collection
from core.report import Report


def prepared(scene: Path, kind: str, wanted: Path, report: Report) -> Path:
    """The folder to train on in place of `scene`, of the kind that find_kind says: itself where it lacks nothing.

    wanted: where what is made should lie. Nothing is written into the scene. Errors: as of structure from motion, and of reading.
    """
    if kind == "photos":
        return scene_of_photos(find_photos(scene), wanted, report)
    if kind in POSED and not len((collection := load_collection(scene)).points):
        return points_beside(collection, wanted, report)
    return scene
