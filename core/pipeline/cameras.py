"""Plain photos -> a scene: what `wegs sfm` does."""

from pathlib import Path

from core.data.load import check_cameras_unknown, find_photos, warn_of_others
from core.data.sfm import originals
from core.data.sfm.reconstruct import reconstruct
from core.errors import command
from core.report import QUIET, Report


def find_cameras(photos: Path, output: Path, report: Report = QUIET) -> Path:
    """Run structure from motion on plain photos; `output` becomes a scene that `train` reads,
    with the split lists of the photos.

    Raises BadInput for a folder without plain photos, and as `core.data.sfm.reconstruct.reconstruct`.
    """
    check_cameras_unknown(photos)
    folder = find_photos(photos)
    warn_of_others(photos, folder, report)
    reconstruct(folder, output, report, lists=(folder, photos))
    if words := originals.shortfall(output):
        report.warn(words)
    report.say(f"Next: {command('wegs', 'train', output)}")
    return output
