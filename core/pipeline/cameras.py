"""Plain photos -> a scene: what `wegs sfm` does."""

from pathlib import Path

from core.data import sfm, sfm_record
from core.data.load import check_cameras_unknown
from core.errors import command
from core.report import QUIET, Report


def find_cameras(photos: Path, output: Path, report: Report = QUIET) -> Path:
    """Put plain photos through structure from motion; `output` then is a scene that `train` reads."""
    check_cameras_unknown(photos)
    sfm.reconstruct(photos, output, report)
    if words := sfm_record.shortfall(output):
        report.warn(words)
    report.say(f"Next: {command('wegs', 'train', output)}")
    return output
