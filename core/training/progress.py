"""The progress bar of a training: how many steps are done, and what a long step is busy with."""

from core.config import Settings
from core.report import OnProgress, Report
from core.training import schedule


def tell_progress(done: int, settings: Settings, note: str, report: Report) -> None:
    """Show that `done` steps are done. note: for the end of the bar."""
    report.progress("Training", done, settings.steps, note, schedule.time_through(settings, done))


def within_step(step: int, what: str, settings: Settings, report: Report) -> OnProgress:
    """A callback that shows in the bar's note how far `what` is, at the end of step `step`;
    on large collections it can take a minute."""
    return lambda seen, views: tell_progress(step - 1, settings, f"{what}: view {seen} of {views}", report)
