"""A trained run and a look -> one file: what `wegs bake` does."""

import time
from dataclasses import replace
from pathlib import Path

import core.export
from core.looks import saved_look
from core.looks.find_look import find_look
from core.looks.look_file import write_look
from core.looks.pruning import pruner_of
from core.pipeline.opened import ONE_LOOK, open_run
from core.report import QUIET, Report
from core.run import viewer_files
from core.run.run_config import check_same_run
from core.system.outputs import check_replaceable
from core.words import counted

VIEWER = "https://superspl.at/editor"


def bake_to_file(
    folder: Path | None,
    appearance: str,
    output: Path,
    report: Report = QUIET,
    *,
    force: bool = False,
    save_as: str | None = None,
    prune: bool = True,
    mask: Path | None = None,
    with_sky: bool = True,
    refine: bool = True,
) -> Path:
    """Bake the look that `appearance` names and write it to `output`; `save_as` keeps the look in the run as well.

    prune: leave out what no training view would miss. mask: of that photo, white where it is to be
    used. with_sky: write the dome, too. refine: refine the look of a photo whose camera is known or can be found.
    Raises BadInput for a run, look, mask or output that cannot be used, BadSetting for a name that a saved look cannot
    have; DiskFull.
    """
    start = time.perf_counter()
    core.export.check_format(output)
    check_replaceable(output, force)
    trained = open_run(folder, report)
    if save_as is not None:
        saved_look.check_free(trained.folder, save_as, force, trained.collection)
    look = find_look(trained, appearance, mask, refine, report)
    report.say(f"{trained.folder}, step {trained.step}{trained.on_device_in_words}, appearance: {look.source}")
    for line in trained.collection.frame.offset_lines():
        report.say(line)
    if not trained.has_looks:
        report.warn(ONE_LOOK)
    check_replaceable(output, force)  # another program may have made it meanwhile
    written = write_look(trained, look, output, report, pruner_of(trained, report) if prune else None, with_sky)
    if save_as is not None:
        check_same_run(trained.folder, trained.identity)
        kept = saved_look.save(trained.folder, replace(look, name=save_as), trained.identity, trained.step)
        report.say(f"Look kept as {kept}")
    report.say(
        f"{output}: {counted(written, 'Gaussian')}, {output.stat().st_size / 1e6:.1f} MB, "
        f"{time.perf_counter() - start:.1f} s"
    )
    cameras = trained.folder / viewer_files.CAMERAS
    viewpoints = f", and {cameras} as well for the photos' viewpoints" if cameras.exists() else ""
    report.say(f"Next: drag {output} into {VIEWER}{viewpoints}")
    if with_sky and trained.sky_count:
        report.say("In the viewer you begin outside the dome of the sky: choose a viewpoint, or fly in")
    return output
