"""Files that appear whole or not at all."""

import errno
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from core.errors import BadInput, WegsError

_FULL = (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path to write, which becomes `path` when the block ends well and is removed when it does not.

    It lies in the same folder, because only there a rename is atomic, and keeps the suffix, by which video and picture
    writers choose their format.
    Raises WegsError for a full disk and BadInput for a folder that is missing or may not be written.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise BadInput(f"There is no folder {path.parent} to write {path.name} in.", f"Type: mkdir -p {path.parent}")
    if path.is_dir():
        raise BadInput(f"{path} is a folder.", "Give the name of a file.")
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as problem:
        if problem.errno in _FULL:
            raise WegsError(f"The disk is full: {path} was not written.", "Free some space and run it again.") from None
        if isinstance(problem, PermissionError) or problem.errno == errno.EROFS:
            raise BadInput(f"{path} may not be written: {problem.strerror}.", "Write to another folder.") from None
        raise
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def filling(folder: Path, patterns: tuple[str, ...], force: bool) -> Iterator[Path]:
    """A temporary folder to fill, whose files become those of `folder` when the block ends well, and else vanish.

    patterns: globs of the files that such a block writes. Raises BadInput, before anything is made, if `folder` has
    files; with `force`, those that match are replaced and others still refused.
    """
    if folder.exists() and not folder.is_dir():
        raise BadInput(f"{folder} is a file.", "Give the name of a folder.")
    old = list(folder.iterdir()) if folder.exists() else []
    foreign = [path for path in old if not any(path.match(pattern) for pattern in patterns)]
    if foreign:
        raise BadInput(f"{folder} holds other files, such as {foreign[0].name}.", "Choose another folder.")
    if old and not force:
        raise BadInput(f"{folder} exists and is not empty.", "Add --force to replace it, or choose another folder.")
    temporary = folder.with_name(f".{folder.name}.{os.getpid()}")
    try:
        temporary.mkdir(parents=True)
        yield temporary
        for path in old:
            path.unlink()
        folder.mkdir(exist_ok=True)
        for path in temporary.iterdir():
            os.replace(path, folder / path.name)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 text file, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def write_json(path: Path, value: Any) -> None:
    """Write indented JSON, whole or not at all."""
    write_text(path, json.dumps(value, indent=1, ensure_ascii=False) + "\n")
