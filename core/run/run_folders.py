"""The run folder: where a run keeps what it made, laid out so that viewers of the original 3DGS project open it too.

cfg_args, cameras.json, input.ply and point_cloud/ are the original project's; config.json, checkpoint_*, appearance/,
history.csv, preview.png, masks/, pictures/, curves/, and results.json, per_view.json and sheet.png of
either protocol are ours.
"""

import os
from collections.abc import Sequence
from pathlib import Path

from core.config import Settings
from core.data.collection import Collection
from core.data.made import CONFIG, fault_of_mark, read_mark
from core.errors import BadInput
from core.evaluation import RESULT_FILES
from core.run import checkpoint, history, viewer_files
from core.run.decision import Decision
from core.run.run_config import write_config
from core.system.atomic import remove, swept
from core.system.lock import taken
from core.system.outputs import check_folder, check_named_as_folder, files_in

PREVIEW = "preview.png"
MASKS, LOOKS, PICTURES, CURVES = "masks", "appearance", "pictures", "curves"  # folders in it
RUNS = Path("runs")
CLOUD = "point_cloud/iteration_{}/point_cloud.ply"  # after so many steps; the last file that a training writes
CLOUDS = CLOUD.format("*")
# All that a run may have written but its checkpoints, and so all else that --force may delete. What makes it a run goes
# last: where deleting is stopped on the way, --force is taken again.
OURS = (
    viewer_files.CFG_ARGS, viewer_files.CAMERAS, viewer_files.POINTS, "point_cloud", checkpoint.TEMPORARY,
    LOOKS, PICTURES, CURVES, history.FILE, MASKS, PREVIEW,
    *(name for names in RESULT_FILES.values() for name in names),
    CONFIG,
)  # fmt: skip


def is_run(folder: Path) -> bool:
    """Whether `folder` holds a run: its config.json names wegs, as no other program's does,
    or is damaged but beside a checkpoint."""
    facts = read_mark(folder / CONFIG)
    return "wegs" in facts or (not facts and (folder / CONFIG).is_file() and checkpoint.newest(folder) is not None)


def default_run() -> Path | None:
    """The run that commands take when none is named: the current folder, by its full name, if it is a run,
    else the one begun last under runs/; None if there is none."""
    here = Path.cwd()
    return here if is_run(here) else newest_in(RUNS)


def newest_in(folder: Path) -> Path | None:
    """The run begun last of those directly in `folder`; None if there is none."""
    runs = [path.parent for path in folder.glob(f"*/{CONFIG}") if is_run(path.parent)]
    return max(runs, key=lambda path: ((path / CONFIG).stat().st_mtime_ns, path.name), default=None)


def find_run(path: Path | None) -> Path:
    """The run at `path`, or the `default_run` for None; BadInput if it is none."""
    if path is None:
        if (found := default_run()) is None:
            what = f"There is no run in {RUNS}/ of the current folder."
            raise BadInput(what, "Give the folder of one, or type: wegs train SCENE")
        return found
    if not is_run(path):
        check_not_within_run(path)
        if path.is_file():
            raise BadInput(f"{path} is a file, not a folder.", "Give the folder of the run, which `wegs train` made.")
        if not path.is_dir():
            raise BadInput(f"There is no folder {path}.", "Give one that `wegs train` made.")
        if (config := path / CONFIG).is_file() and (fault := fault_of_mark(config)):  # it may have been one's
            raise BadInput(f"{config} {fault}, and {path} has no checkpoint.", "If it was a run, train it again.")
        inner = newest_in(path)
        fix = f"Give a run in it, such as {inner}." if inner else "Give a folder that `wegs train` made."
        raise BadInput(f"{path} is not a run: it holds no {CONFIG} of wegs.", fix)
    return path


def check_not_within_run(path: Path) -> None:
    """Raise BadInput for a file or folder that lies in a run, however deep."""
    if path.exists() and (run := next(filter(is_run, (*path.parents, *path.absolute().parents)), None)):
        kind = "folder" if path.is_dir() else "file"
        raise BadInput(f"{path} is a {kind} in a run.", f"Give the folder of the run: {run}")


def is_at_work(folder: Path) -> bool:
    """Whether a training holds the run (core.run.claim)."""
    with taken(folder) as ours:
        return ours is False


def is_default(folder: Path) -> bool:
    """Whether `folder` is the `default_run`."""
    found = default_run()
    return found is not None and found.resolve() == folder.resolve()


def choose_folder(output: Path | None, scene_name: str, force: bool = False) -> Path:
    """The folder of a new run, not yet made: `output`, or the first free one of runs/SCENE, runs/SCENE-2, ...

    Raises BadInput for an output that exists, unless it is empty or, with `force`, a run, and where nothing may be
    written; BadSetting for one that is named as a .ply.
    """
    if output is None:
        scene_name = scene_name.encode(errors="surrogateescape").decode(errors="replace")
        path, number = RUNS / scene_name, 1
        # A link to nothing takes its name as well; a folder that a killed training left empty does not.
        while os.path.lexists(path) and not swept(path, Path.rmdir):
            number += 1
            path = RUNS / f"{scene_name}-{number}"
        check_folder(path, "Choose another -o.")
        return path
    checkpoint.check_name(output, "Choose another -o.")
    check_named_as_folder(output, (".ply",), "a run is a folder, with a .ply in it")
    check_folder(output, "Choose another -o.")
    if output.exists() and files_in(output):
        if not is_run(output):
            raise BadInput(f"{output} holds files that are no run.", "Choose another -o, or empty it yourself.")
        if not force:
            raise BadInput(
                f"{output} holds a run.", "Add --force to replace it, --resume to go on with it, or choose another -o."
            )
    return output


def check_writable(folder: Path, option: str = "--run") -> None:
    """Raise BadInput unless `folder`, a run or one in it, can be written in:
    what belongs there can be put nowhere else by an option.

    option: by which the command takes a run.
    """
    check_folder(folder, f"Make it writable, or copy the run and name the copy by {option}.")


def create(folder: Path, collection: Collection, settings: Settings, decisions: Sequence[Decision] = ()) -> None:
    """Make the folder of a new run, in place of an older run, and write all that is known before the first step.

    Where that fails, nothing is left in it. config.json comes first: whatever a kill leaves is a run, which can go on
    or be replaced.
    """
    _clear(folder)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        write_config(folder, collection, settings, decisions)
        viewer_files.write(folder, collection, settings.transparent_is_empty)
    except BaseException:
        _clear(folder)
        raise


def _clear(folder: Path) -> None:
    """Delete what a run wrote into `folder`, and nothing else."""
    for path in [*checkpoint.written(folder), *(path for pattern in OURS for path in folder.glob(pattern))]:
        remove(path)


def point_cloud_path(folder: Path, step: int) -> Path:
    """Where viewers look for the Gaussians after `step` steps; the folder is made."""
    path = folder / CLOUD.format(step)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        fix = f"Move what is there away, then type: {checkpoint.how_to_go_on(folder)}"
        raise BadInput(f"{path.parent} cannot be made: a file is in the way.", fix) from None
    return path
