"""Cameras of plain photos, found once: structure from motion takes minutes, and its result is kept beside the runs."""

import json
from pathlib import Path

from core.data import sfm
from core.data.colmap import MODEL_FOLDERS
from core.data.model_file import holds_model
from core.data.photo_file import list_photos
from core.report import Report

MARK = "photos.json"  # in a scene: the photos it was made of


def scene_of_photos(photos: Path, wanted: Path, report: Report) -> Path:
    """Where the COLMAP scene of the photos in the folder `photos` lies; it is made now unless it is there already.

    wanted: where it should lie; if another scene does, a number is added. A scene that is there is used again only for
    the very same files (path, size and time of change of each). Errors: as sfm.reconstruct.
    """
    made_of = {str(path.resolve()): [path.stat().st_size, path.stat().st_mtime_ns] for path in list_photos(photos)}
    scene, number = wanted, 1
    while scene.exists():
        if _made_of(scene) == made_of:
            report.say(f"Cameras as found before in {scene}; remove it to have them found again.")
            return scene
        number += 1
        scene = wanted.with_name(f"{wanted.name}-{number}")
    above = photos.resolve().parent
    if any(holds_model(above / name) for name in MODEL_FOLDERS):
        report.warn(f"{above} holds a COLMAP model: give that folder to use its cameras. Now they are found anew.")
    sfm.reconstruct(photos, scene, report)
    (scene / MARK).write_text(json.dumps(made_of, indent=1), encoding="utf-8")
    return scene


def _made_of(scene: Path) -> dict | None:
    try:
        return json.loads((scene / MARK).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
