"""The bar of a training: how many steps are done, and what takes its time where the next one is long."""

from core.config import Settings
from core.report import Report, Told
from core.training import schedule


def tell_progress(done: int, settings: Settings, note: str, report: Report) -> None:
    """So many steps are done. note: for the end of the bar."""
    report.progress("Training", done, settings.steps, note, schedule.time_through(settings, done))


def within_step(done: int, what: str, settings: Settings, report: Report) -> Told:
    """Tells in the note how far `what` is, in the step that follows so many: on large collections the bar stands still for a minute."""
    return lambda seen, views: tell_progress(done, settings, f"{what}: view {seen} of {views}", report)
