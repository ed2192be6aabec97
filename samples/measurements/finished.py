"""Trains and measures a run once: finished figures are read from a file, and a run that was killed is resumed."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

from core import pipeline
from core.config import Settings
from core.data import find_kind
from core.data.collection import Collection
from core.data.made import digest
from core.data.photos.names import is_file
from core.data.split import TEST_LISTS
from core.data.split_table import find_tables, read_split_table
from core.errors import BadInput
from core.evaluation import lpips
from core.report import Report
from core.run import run_folders
from core.run.run_config import changed_files, read_config
from core.system.atomic import replacing_folder, write_json
from core.system.outputs import check_folder
from core.words import list_names


def measured(scene: Path, settings: Settings, folder: Path, protocols: Sequence[str], report: Report) -> dict:
    """The figures of `settings` on `scene`, by protocol as in results.json, under "results";
    the .ply's size under "bytes".

    They are kept beside the run's folder, in FOLDER.json, with the scene and settings, and not measured twice, unless
    LPIPS was absent and is there by now; delete the file to train again. A run with other settings is replaced. Raises
    BadInput, before that, for what is no scene, where nothing can be written, and where the run is of another scene
    (folders called `dense` or `images` are many) or its photos have changed since.
    """
    path = folder.with_name(f"{folder.name}.json")
    key = {"scene": str(scene.resolve()), "settings": settings.to_json()}
    kept = json.loads(path.read_text()) if path.is_file() else {}
    if {name: kept.get(name) for name in key} != key:
        find_kind(scene)
        check_folder(path.parent)
        if kept.get("scene", key["scene"]) != key["scene"]:
            raise BadInput(f"{path} holds the figures of another scene, {kept['scene']}.", "Choose another -o.")
        kept = key | {"results": {}}
        path.unlink(missing_ok=True)
        if run_folders.is_run(folder):
            shutil.rmtree(folder)  # of other or unknown settings
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, kept)
    elif run_folders.is_run(folder) and (changed := _changed(read_config(folder).collection, kept.get("photos", {}))):
        raise BadInput(
            f"Photos in {scene}, or their masks, are not those that {folder} was trained on: {list_names(changed)}.",
            f"Choose another -o, or delete {path} to train again.",
        )
    missing = [protocol for protocol in protocols if is_missing(kept["results"].get(protocol))]
    if missing:
        if not run_folders.is_run(folder):
            pipeline.train(scene, settings, folder, report)
        elif not any(folder.glob(run_folders.CLOUDS)):
            pipeline.resume(folder, report)
        (cloud,) = folder.glob(run_folders.CLOUDS)
        kept["bytes"] = cloud.stat().st_size
        kept.setdefault("photos", _digests(read_config(folder).collection))
    for protocol in missing:
        kept["results"][protocol] = pipeline.evaluate(folder, protocol, report).to_json()
        write_json(path, kept)
    return kept


def _changed(collection: Collection, then: dict[str, list[str]]) -> list[str]:
    """The names of photos that changed, they or their masks, since the run was trained. then: their digests."""
    by_size = changed_files(collection)  # all that is known of a run that was killed
    return by_size or [name for name, digests in _digests(collection).items() if then.get(name, digests) != digests]


def _digests(collection: Collection) -> dict[str, list[str]]:
    """Of the file of each photo and of its mask, by the photo's name; without photos of which one is missing."""
    files = {
        photo.name: [photo.path] if photo.mask is None else [photo.path, photo.mask.path] for photo in collection.photos
    }
    return {name: list(map(digest, paths)) for name, paths in files.items() if all(map(is_file, paths))}


def is_missing(result: dict | None) -> bool:
    """Whether a run has yet to be measured: not at all so far, or without LPIPS, whose weights are there by now."""
    return result is None or (result["lpips"] != lpips.BACKBONE and lpips.load() is not None)


def with_split(scene: Path, table: Path, folder: Path) -> Path:
    """A copy of `scene` that is split as the .tsv `table` says:
    choices are made by another split than the one by which figures are published.

    It is a folder of links, FOLDER/SCENE-TABLE. Raises BadInput for what is no split table, and if there is such a
    folder of another scene or with another split, to which older figures belong.
    """
    read_split_table(table)
    made = folder / f"{scene.resolve().name}-{table.stem}"
    copy = made / f"{table.stem}.tsv"  # the scene's reader looks for no other suffix
    if copy.is_file():
        if copy.read_bytes() != table.read_bytes():
            raise BadInput(f"{copy} is another split than {table}.", "Choose another -o.")
        if any(link.readlink().parent != scene.resolve() for link in made.iterdir() if link.is_symlink()):
            raise BadInput(f"{made} is a copy of another scene than {scene}.", "Choose another -o.")
        return made
    tables = [path for group in find_tables(scene.resolve()) for path in group]
    with replacing_folder(made) as work:
        (work / "scene").mkdir()
        for entry in scene.resolve().iterdir():
            if entry not in tables and entry.name not in TEST_LISTS:
                (work / "scene" / entry.name).symlink_to(entry)
        shutil.copy(table, work / "scene" / copy.name)
    return made
