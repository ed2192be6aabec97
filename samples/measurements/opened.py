"""Runs whose looks can be measured: they have looks, and photos that were held out."""

from pathlib import Path

from core.data.collection import Photo
from core.errors import BadInput
from core.looks.trained import TrainedRun
from core.pipeline.opened import open_run
from wegs_cli.terminal import Terminal


def opened(folder: Path | None) -> tuple[TrainedRun, tuple[Photo, ...]]:
    """The run (default: the newest) and its held-out photos; BadInput where it has no looks or no such photos."""
    trained = open_run(folder, Terminal())
    if not trained.has_looks:
        raise BadInput(
            f"{trained.folder} has one look only: nothing is read from photos.",
            "Take a run with appearance=full or exposure.",
        )
    if not (held_out := trained.collection.split("test")):
        raise BadInput(f"{trained.folder} has no held-out photos.", "Take a run without --all-photos.")
    return trained, held_out
