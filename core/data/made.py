"""Folders that wegs made (runs, scenes, points), recognised later by a file in them, the mark,
that says what they were made of."""

import hashlib
import json
import os
from collections.abc import Callable, Iterable
from pathlib import Path

from core.report import Report
from core.system.atomic import MadeMeanwhile
from core.words import list_names

CONFIG = "config.json"  # of a run
MADE_OF = "photos.json"  # of a scene made of plain photos: these files
FADE = ("frame_*.png", "sheet.png", "step_*.ply", "video.mp4")  # what an interpolation writes, the first two always


def scene_beside(output: Path, scene: Path) -> Path:
    """Where the cameras or points that `scene` lacks are kept: beside what is made of it."""
    return output.absolute().parent / f"{scene.resolve().name or 'scene'}-scene"


def made_once(
    wanted: Path, mark: str, is_wanted: Callable[[Path], bool], make: Callable[[Path], None], what: str, report: Report
) -> Path:
    """The first of wanted, wanted-2, wanted-3, ... for which `is_wanted` holds;
    if none does, the first that does not exist, made by `make`. If another training makes that one meanwhile, it is
    taken if `is_wanted` holds, or else what is wanted is made again, under the next name.

    mark: the file by which such a folder is recognised; those that were made of something else are named to the user.
    what: words for the content, such as "Points as triangulated", to say that it is used again. Raises what `make`
    raises.
    """
    folder, number, others = wanted, 1, []
    while os.path.lexists(folder) and not is_wanted(folder):
        if (folder / mark).is_file():
            others.append(str(folder))
        number += 1
        folder = wanted.with_name(f"{wanted.name}-{number}")
    if not os.path.lexists(folder):
        if others:
            stay = "stay; remove those that no run needs" if len(others) > 1 else "stays; remove it if no run needs it"
            report.say(
                f"Made anew in {folder}. Of other photos, or of these before a change: "
                f"{list_names(others)}, which {stay}."
            )
        try:
            make(folder)
            return folder
        except MadeMeanwhile:
            if not (folder / mark).is_file():
                raise
            return made_once(wanted, mark, is_wanted, make, what, report)
    report.say(f"{what} before in {folder}; remove it to have them found again.")
    return folder


def read_mark(path: Path) -> dict:
    """The facts in a JSON file that says what a folder was made of; none if it is missing or damaged."""
    return _facts_and_fault(path)[0]


def fault_of_mark(path: Path) -> str | None:
    """Why `read_mark` reads nothing from a file, in words that follow its name; None if it is JSON."""
    return _facts_and_fault(path)[1]


def _facts_and_fault(path: Path) -> tuple[dict, str | None]:
    try:
        # Bytes, as json then skips the byte-order mark that some Windows editors write.
        facts = json.loads(path.read_bytes())
    except OSError as problem:
        return {}, f"cannot be read ({problem.strerror})"
    except (ValueError, RecursionError):
        return {}, "is damaged: it is no JSON"
    return facts if isinstance(facts, dict) else {}, None


def path_from(root: Path, path: Path) -> str:
    """The path relative to `root`, so that both may be moved together: as it is if it leads through a link in `root`,
    and beginning with `..` if it lies outside. The whole path if there is no relative one, as between drives of
    Windows."""
    inside, home = Path(os.path.abspath(path)), Path(os.path.abspath(root))
    if inside.is_relative_to(home) and inside.resolve() == path.resolve():  # not where `..` follows a link
        return inside.relative_to(home).as_posix()
    return relative_path_to(path, root) or path.resolve().as_posix()


def relative_path_to(target: Path, folder: Path) -> str | None:
    """The relative path from `folder` to `target`; None if there is none, as between drives of Windows."""
    try:
        return Path(os.path.relpath(target.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return None


def moved_together(recorded: Path, way: str | None, folder: Path, files: Iterable[str]) -> Path:
    """The folder `recorded` or, if it is gone, the one that the relative path `way` leads to from `folder`:
    both may have been moved together.

    files: what `recorded` held. A folder with none of them is a different one: a path such as ../.. leads to some
    folder from anywhere.
    """
    if not way or recorded.is_dir():
        return recorded
    together = (folder / str(way)).resolve()
    return together if together.is_dir() and any(os.path.isfile(together / file) for file in files) else recorded


def holds_run_config(folder: Path) -> bool:
    """Whether the folder's config.json is one of wegs, so that its pictures are not photos.
    (`run_folders.is_run` also knows a damaged one.)"""
    return "wegs" in read_mark(folder / CONFIG)


def is_of_wegs(folder: Path) -> bool:
    """Whether the folder is a run, a scene made of plain photos, or holds the frames of an interpolation."""
    is_scene = (folder / MADE_OF).is_file() and (folder / "sparse").is_dir()
    return is_scene or holds_run_config(folder) or all(any(folder.glob(pattern)) for pattern in FADE[:2])


def stamp(path: Path) -> list[int]:
    """Size (bytes) and modification time (ns) of a file, which tell whether it has changed."""
    facts = path.stat()
    return [facts.st_size, facts.st_mtime_ns]


def digest(path: Path, count: int = -1) -> str:
    """The hash (SHA-256) of a file, or of its first `count` bytes."""
    with path.open("rb") as file:
        return hashlib.sha256(file.read(count)).hexdigest()
