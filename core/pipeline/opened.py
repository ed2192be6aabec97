"""The run that a command works on: found, loaded, and told about where it is unfinished."""

from pathlib import Path

from core.errors import command
from core.looks.trained import TrainedRun, load_run
from core.report import Report
from core.system.lock import taken
from core.training.on_disk import run_folders


def open_run(folder: Path | None, report: Report) -> TrainedRun:
    """The run in `folder`, or the newest one for None, as of its last checkpoint; a warning if that is not its last step."""
    trained = load_run(run_folders.find_run(folder))
    if trained.step < trained.settings.steps:
        with taken(trained.folder) as free:
            how = "is still being trained" if free is False else f"was stopped; {command('wegs', 'train', '--resume', '-o', trained.folder)} goes on"
        report.warn(f"{trained.folder} {how}: this is step {trained.step} of {trained.settings.steps}.")
    return trained
