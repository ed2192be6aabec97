"""Finds and loads the run that a command works on, with a warning if it is unfinished or its files have changed."""

from pathlib import Path

from core.looks.trained import TrainedRun, load_run
from core.report import Report
from core.run import checkpoint, run_config, run_folders
from core.words import list_names

ONE_LOOK = "This run was trained without appearance: all its looks are one."


def open_run(folder: Path | None, report: Report) -> TrainedRun:
    """The run in `folder` (None: the newest) at its last checkpoint;
    warns if that is not its last step, or if files have changed."""
    trained = load_run(run_folders.find_run(folder))
    if trained.step < trained.settings.steps:
        stopped = f"was stopped; {checkpoint.how_to_go_on(trained.folder)} goes on"
        state = "is still being trained" if run_folders.is_at_work(trained.folder) else stopped
        report.warn(f"{trained.folder} {state}: this is step {trained.step} of {trained.settings.steps}.")
    if changed := run_config.changed_files(trained.collection):
        report.warn(
            "Photos or their masks changed since this run began, "
            f"so looks and figures may be wrong: {list_names(changed)}"
        )
    return trained
