"""A look of a run as a file for viewers."""

from pathlib import Path

import core
import core.export
from core.report import Report
from core.training.trained import Appearance, Run, bake
from core.training.trim import Trim, Trimmed


def write_look(trained: Run, appearance: Appearance, path: Path, report: Report, trim: Trim | None) -> int:
    """Bake and write one look, trimmed unless that is None; returns how many Gaussians it has."""
    look = bake(trained, appearance)
    trimmed = Trimmed(look, 0, 0, 0.0) if trim is None else trim(look)
    splats = trimmed.splats
    frame = trained.collection.frame
    maker = f"wegs {core.__version__}, run {trained.identity}, look {appearance.name}"
    dropped = core.export.write(path, splats.in_world(frame.for_files()), ". ".join([maker, *frame.offset_notes()]))
    if dropped:
        report.warn(
            f"{path}: {dropped} Gaussians could not be drawn (NaN, Inf or a zero quaternion) and were left out."
        )
    written = len(splats) - dropped
    gone = []
    if trimmed.gaussians:
        gone.append(f"{trimmed.gaussians} Gaussians ({path.stat().st_size / written * trimmed.gaussians / 1e6:.1f} MB)")
    if trimmed.bands:
        # A row of a vanilla .ply is 248 bytes whatever the degree: some viewers count on it.
        gone.append(f"the SH bands above degree {splats.degree} (zeros in a .ply)")
    if gone:
        bound = f"no training view changes by more than {trimmed.largest:.2f} of 255"
        report.say(f"{path.name} does without {' and '.join(gone)}: {bound}")
    return written
