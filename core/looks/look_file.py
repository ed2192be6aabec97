"""Writes a look of a run as a file for viewers."""

from pathlib import Path

import core.export
from core.export.ply import header_comment
from core.looks.pruning import Pruned, Pruner
from core.looks.trained import Look, TrainedRun, bake
from core.report import Report
from core.words import counted


def write_look(
    trained: TrainedRun, look: Look, path: Path, report: Report, pruner: Pruner | None, with_sky: bool = True
) -> int:
    """Bake and write one look; returns how many Gaussians were written. pruner: None keeps all Gaussians."""
    baked = bake(trained, look)
    pruned = Pruned(baked) if pruner is None else pruner(baked)
    splats = pruned.splats if with_sky else pruned.splats[: len(pruned.splats) - trained.sky_count]
    frame = trained.collection.frame
    maker = header_comment(trained.identity, trained.sky_count if with_sky else 0, look.name)
    dropped = core.export.write(path, splats.in_world(frame.for_files()), ". ".join([maker, *frame.offset_lines()]))
    if dropped:
        undrawable = f"{counted(dropped, 'Gaussian')} that cannot be drawn (NaN, Inf or a zero quaternion)"
        report.warn(f"{path.name}: {undrawable} left out.")
    written = len(splats) - dropped
    gone = []
    if pruned.gaussians:
        gone.append(counted(pruned.gaussians, "Gaussian"))
    if pruned.bands:
        # A row of a vanilla .ply is 248 bytes whatever the degree: some viewers count on it.
        gone.append(f"the SH bands above degree {splats.degree} (zeros in a .ply)")
    if gone:
        bound = "no training view changes"
        if pruned.largest:
            bound = f"in no training view does a pixel change by more than {max(pruned.largest, 0.01):.2f} of 255"
        report.say(f"Left out {' and '.join(gone)}: {bound}; `wegs bake --prune off` keeps all")
    return written
