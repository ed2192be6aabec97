"""Files that appear whole or not at all."""

import errno
import json
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from core.errors import FULL, BadInput, WegsError, command, disk_full

_REFUSED = (
    *(errno.EACCES, errno.EPERM, errno.EROFS, errno.ENAMETOOLONG, errno.EINVAL),
    *(errno.ENOENT, errno.ENOTDIR),  # the folder is gone
    errno.EFBIG,  # of the disk (4 GB on FAT), or `ulimit -f`
)


def check_folder(folder: Path, fix: str = "Write to another folder.") -> None:
    """Raise BadInput unless `folder` can be written in, or be made. fix: what to do where it is read-only."""
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not there.is_dir():
        raise BadInput(f"{there} is not a folder.", "Write to another folder.")
    if not os.access(there, os.W_OK):
        raise BadInput(f"The folder {there} may not be written in.", fix)


def check_apart(folder: Path, given: Iterable[Path]) -> None:
    """Raise BadInput where something that the user gave lies in `folder`, whose files are about to be deleted for new ones."""
    for path in given:
        # A link in the folder goes as well, though what it leads to stays.
        inside = path.resolve().is_relative_to(folder.resolve()) or path.absolute().is_relative_to(folder.absolute())
        if inside and path.exists():
            raise BadInput(f"{path} lies in {folder}, whose files are replaced.", "Choose another -o, or move it out first.")


def check_file(path: Path) -> None:
    """Raise BadInput unless a file can be written as `path`: asked before the work, not after it."""
    if path.is_dir():
        raise BadInput(f"{path} is a folder.", "Give the name of a file.")
    check_folder(path.parent)
    if not path.parent.exists():
        fix = f"Type: {command('mkdir', '-p', path.parent)}"
        raise BadInput(f"There is no folder {path.parent} to write {path.name} in.", fix)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """What the system refuses while `path` is written, as an error that names it."""
    try:
        yield
    except OSError as problem:
        if problem.errno in FULL:
            raise disk_full(path) from None
        if problem.errno in _REFUSED:
            raise BadInput(f"{path} could not be written: {problem.strerror}.", "Write to another folder.") from None
        raise


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path to write, which becomes `path` when the block ends well and is removed when it does not.

    It lies in the same folder, because only there a rename is atomic, and keeps the suffix, by which video and picture
    writers choose their format.
    Raises WegsError for a full disk and BadInput for a folder that is missing or may not be written.
    """
    path = Path(path)
    check_file(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        with _named(path):
            yield temporary
            os.replace(temporary, path)
    finally:
        with suppress(OSError):  # where nothing may be written, nothing is left to remove
            temporary.unlink()


@contextmanager
def filling(folder: Path, patterns: tuple[str, ...], force: bool) -> Iterator[Path]:
    """A temporary folder to fill, whose files become those of `folder` when the block ends well, and else vanish.

    patterns: globs of the files that such a block writes. Raises BadInput, before anything is made, if `folder` has
    files; with `force`, those that match are replaced and others still refused.
    """
    check_folder(folder)
    old = list(folder.iterdir()) if folder.exists() else []
    foreign = [path for path in old if not any(path.match(pattern) for pattern in patterns)]
    if foreign:
        raise BadInput(f"{folder} holds other files, such as {foreign[0].name}.", "Choose another folder.")
    if old and not force:
        raise BadInput(f"{folder} exists and is not empty.", "Add --force to replace it, or choose another folder.")
    # Inside a folder that is there: it may be a disk of its own, where no file can be moved from beside it.
    temporary = (folder if folder.exists() else folder.parent) / f".{folder.resolve().name}.{os.getpid()}"
    try:
        with _named(folder):
            temporary.mkdir(parents=True)
            yield temporary
            for path in old:
                path.unlink()
            folder.mkdir(exist_ok=True)
            for path in temporary.iterdir():
                os.replace(path, folder / path.name)
    except WegsError as problem:  # whoever reads it knows nothing of the temporary folder
        raise type(problem)(problem.what.replace(str(temporary), str(folder)), problem.fix) from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 text file, whole or not at all."""
    write_bytes(path, text.encode())


def write_json(path: Path, value: Any) -> None:
    """Write indented JSON, whole or not at all."""
    write_text(path, json.dumps(value, indent=1, ensure_ascii=False) + "\n")
