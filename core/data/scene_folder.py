"""A folder of results that appears whole or not at all, says plainly where it cannot be written, and is found again."""

import errno
import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from core.errors import FULL, BadInput, WegsError, disk_full, not_made

CONFIG = "config.json"  # of a run
FADE = ("frame_*.png", "sheet.png", "step_*.ply", "video.mp4")  # what an interpolation writes, the first two always


@contextmanager
def replacing_folder(output: Path) -> Iterator[Path]:
    """A temporary folder; what its folder scene/ holds becomes that of `output` when the block ends well.

    It lies beside `output`, or inside where that is there, empty: it may be a disk of its own (a container's volume).
    """
    is_there = output.is_dir()
    work = (output if is_there else output.parent) / f".{output.name}.{os.getpid()}"
    try:
        work.mkdir(parents=True)
    except OSError as problem:
        raise not_made(output, problem) from None
    try:
        yield work
        for part in sorted((work / "scene").iterdir()) if is_there else ():  # sparse/ comes last, and makes it a scene
            os.replace(part, output / part.name)
        if not is_there:
            os.replace(work / "scene", output)
    except WegsError:
        raise
    except OSError as problem:
        if problem.errno in FULL:
            raise disk_full(output) from None
        if problem.errno in (errno.ENOTEMPTY, errno.EEXIST):
            raise BadInput(
                f"{output} was made by another program meanwhile.", "Use that one, or choose another -o."
            ) from None
        if isinstance(problem, PermissionError) or problem.errno == errno.EROFS:
            raise BadInput(f"{output} may not be written: {problem.strerror}.", "Choose another -o.") from None
        raise
    except Exception:
        # pycolmap and SQLite name a full disk in their own ways.
        if work.exists() and shutil.disk_usage(work).free < 1 << 20:
            raise disk_full(output) from None
        raise
    finally:
        shutil.rmtree(work, ignore_errors=True)


def kept(wanted: Path, is_it: Callable[[Path], bool]) -> tuple[Path, bool]:
    """The folder `wanted`, or the first of wanted-2, wanted-3, ... that is free or that `is_it`; and whether it is."""
    folder, number = wanted, 1
    while folder.exists():
        if is_it(folder):
            return folder, True
        number += 1
        folder = wanted.with_name(f"{wanted.name}-{number}")
    return folder, False


def write_mark(path: Path, facts: dict) -> None:
    """What `read_mark` reads again."""
    path.write_text(json.dumps(facts, indent=1), encoding="utf-8")


def read_mark(path: Path) -> dict:
    """The facts in a JSON file that says what a folder was made of; none where it is missing or garbled."""
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return facts if isinstance(facts, dict) else {}


def path_within(path: Path, root: Path) -> str:
    """The path relative to `root` where it lies in it, so that the folder may be moved; else the whole."""
    path, root = path.resolve(), root.resolve()
    return (path.relative_to(root) if path.is_relative_to(root) else path).as_posix()


def way_to(target: Path, folder: Path) -> str | None:
    """The relative path from `folder` to `target`; None where there is none: from one drive of Windows to another."""
    try:
        return Path(os.path.relpath(target.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return None


def followed(place: Path, way: str | None, folder: Path) -> Path:
    """The folder `place`, or, if it is gone, the one that `way` leads to from `folder`: where both were moved with each other."""
    together = (folder / str(way)).resolve()
    return together if way and together.is_dir() and not place.is_dir() else place


def is_of_run(folder: Path) -> bool:
    """Whether the folder is a run of wegs, whose pictures are no photos."""
    return "wegs" in read_mark(folder / CONFIG)


def is_of_wegs(folder: Path) -> bool:
    """Whether the folder is a run, or holds the frames of an interpolation."""
    return is_of_run(folder) or all(any(folder.glob(pattern)) for pattern in FADE[:2])


def stamp(path: Path) -> list[int]:
    """Size (bytes) and time of change (ns) of a file: whether it is the one it was."""
    return [path.stat().st_size, path.stat().st_mtime_ns]
