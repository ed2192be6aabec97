"""A run with its figures, once: what was measured is read, what was killed goes on, and only the rest is trained."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from core import pipeline
from core.config import Settings
from core.errors import BadInput, BadSetting
from core.export.atomic import write_json
from core.report import Report
from core.training import checkpoint, run


def measured(scene: Path, settings: Settings, folder: Path, protocols: Sequence[str], report: Report) -> dict:
    """The figures of `settings` on `scene`, by protocol as in results.json, under "results"; the .ply's size under "bytes".

    They are kept beside the run's folder, in FOLDER.json, and not measured twice; delete the file to measure again, the folder too
    to train again.
    """
    path = folder.with_name(f"{folder.name}.json")
    key = {"scene": str(scene.resolve()), "settings": settings.to_json()}
    kept = json.loads(path.read_text()) if path.is_file() else {}
    if {name: kept.get(name) for name in key} != key:
        kept = key | {"results": {}}
    missing = [protocol for protocol in protocols if protocol not in kept["results"]]
    if missing:
        _finish(scene, settings, folder, report)
        kept["bytes"] = run.point_cloud_path(folder, _step(checkpoint.newest(folder))).stat().st_size
    for protocol in missing:
        kept["results"][protocol] = pipeline.evaluate(folder, protocol, report).to_json()
        write_json(path, kept)
    return kept


def _finish(scene: Path, settings: Settings, folder: Path, report: Report) -> None:
    """Make `folder` a whole run of these settings: what was stopped goes on, what is another run's is trained anew."""
    decided = _as_decided(folder, scene, settings)
    if decided is not None and (newest := checkpoint.newest(folder)) is not None:
        step = _step(newest)
        if step < decided.steps:
            pipeline.resume(folder, report)
            return
        if run.point_cloud_path(folder, step).is_file():
            return
    pipeline.train(scene, settings, folder, report, force=True)


def _step(path: Path) -> int:
    return checkpoint.read_facts(path)["step"]


def _as_decided(folder: Path, scene: Path, settings: Settings) -> Settings | None:
    """What the run in `folder` made of these settings; None if it is a run of others, or none."""
    try:
        _, decided, collection = run.read_config(folder)
    except (BadInput, BadSetting):
        return None
    answers = {name: getattr(decided, name) for name in settings.undecided}
    return decided if collection.root.resolve() == scene.resolve() and replace(settings, **answers) == decided else None


def with_split(scene: Path, table: Path, folder: Path) -> Path:
    """A scene like `scene`, but split as the .tsv `table` says, for choices that no published figure may depend on.

    It is a folder of links, FOLDER/SCENE-TABLE. Raises BadInput where one of another content is there: its figures are of that.
    """
    made = folder / f"{scene.resolve().name}-{table.stem}"
    copy = made / table.name
    if copy.is_file():
        if copy.read_bytes() != table.read_bytes():
            raise BadInput(f"{copy} is another split than {table}.", "Choose another -o.")
        return made
    made.mkdir(parents=True)
    for entry in scene.resolve().iterdir():
        if entry.suffix != ".tsv" and entry.name != "test.txt":
            (made / entry.name).symlink_to(entry)
    shutil.copy(table, copy)
    return made
