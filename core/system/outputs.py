"""Checks, before the work rather than after it, that an output can be written where the user wants it."""

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from core.errors import BadInput, BadSetting, as_disk_full, command

TEMPORARY = ".wegs-"  # in the names of temporary folders of work in progress


def check_folder(folder: Path, fix: str = "Write to another folder.") -> None:
    """Raise BadInput unless `folder` can be written in, or be made; DiskFull. fix: what to do where it is read-only."""
    there = _nearest(folder)
    try:
        # Tried, because permissions do not tell: root has them in /proc, too.
        os.rmdir(tempfile.mkdtemp(prefix=TEMPORARY, dir=there))
    except OSError as problem:
        raise as_disk_full(problem, folder) or BadInput(
            f"The folder {there} may not be written in: {problem.strerror}.", fix
        ) from None


def _nearest(folder: Path) -> Path:
    """`folder`, or the nearest one above it that exists; BadInput if that is not a folder."""
    above = (path for path in (folder, *folder.absolute().parents) if os.path.lexists(path))  # a broken link exists
    there = next(above, folder)  # none exists on a drive that Windows lacks
    if not there.is_dir():
        raise BadInput(f"{there} is not a folder.", "Write to another folder.")
    return there


def check_named_as_folder(output: Path, suffixes: tuple[str, ...], what: str) -> None:
    """Raise BadSetting for a new -o with one of the `suffixes` of files, where a folder is to be made.
    what: says so, in words."""
    if output.suffix.lower() in suffixes and not output.exists():
        raise BadSetting(f"-o {output}: {what}.", f"Type: {command('-o', output.with_suffix(''))}")


def files_in(folder: Path) -> list[Path]:
    """What the folder holds, without temporary folders (of work in progress, or left by a kill)."""
    return [path for path in folder.iterdir() if TEMPORARY not in path.name]


def check_apart(folder: Path, given: Iterable[Path]) -> None:
    """Raise BadInput if something that the user gave lies in `folder`, whose files are about to be replaced."""
    for path in given:
        # A link in the folder is deleted, too, although what it points to stays.
        inside = path.resolve().is_relative_to(folder.resolve()) or path.absolute().is_relative_to(folder.absolute())
        if inside and path.exists():
            raise BadInput(
                f"{path} lies in {folder}, whose files are replaced.", "Choose another -o, or move it out first."
            )


def check_file(path: Path) -> None:
    """Raise BadInput unless a file can be written as `path`."""
    check_folder(path.parent)
    check_target(path)


def check_target(path: Path) -> None:
    """Raise BadInput unless `path` names a file in a folder that exists;
    whether the folder is writable is not tried."""
    if path.is_dir():
        raise BadInput(f"{path} is a folder.", "Give the name of a file.")
    _nearest(path.parent)
    if path.parts[0] == "~":
        raise BadInput(
            f"{path} names no home folder: the shell replaces ~ only at the start of a word.",
            f"Type: -o {path}, with a space",
        )
    if not path.parent.exists():
        fix = f"Type: {command('mkdir', '-p', path.parent)}"
        raise BadInput(f"There is no folder {path.parent} to write {path.name} in.", fix)


def check_replaceable(path: Path, force: bool) -> None:
    """As `check_file`, and BadInput for a file that exists, unless `force` is given."""
    check_file(path)
    if os.path.lexists(path) and not force:  # a broken link would be replaced, too
        raise BadInput(f"{path} exists.", "Add --force to replace it, or choose another -o.")


def check_fillable(folder: Path, patterns: tuple[str, ...], force: bool) -> list[Path]:
    """What `core.system.atomic.filling` would replace in the folder; raises BadInput as that does."""
    check_folder(folder)
    old = files_in(folder) if folder.exists() else []
    foreign = [path for path in old if not any(path.match(pattern) for pattern in patterns)]
    if foreign:
        raise holds_others(folder, foreign[0])
    if old and not force:
        raise BadInput(f"{folder} exists and is not empty.", "Add --force to replace it, or choose another folder.")
    return old


def holds_others(folder: Path, example: Path) -> BadInput:
    """The error for a folder of results that holds other files than ours, such as the `example`."""
    return BadInput(f"{folder} holds other files, such as {example.name}.", "Choose another folder, or move them out.")
