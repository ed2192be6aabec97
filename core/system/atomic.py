"""Files and folders that appear whole or not at all, with clear errors where they cannot be written."""

import errno
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from core.errors import BadInput, DiskFull, WegsError, as_disk_full, disk_full
from core.system.lock import taken
from core.system.outputs import TEMPORARY, check_fillable, check_target, files_in

KEPT = f"{TEMPORARY}kept"  # ends the names of temporary folders that are kept after a stop
# Characters of a name that its temporary folder repeats; with four bytes each, the longest of them stays within the
# usual 255.
NAME_PART = 58
FRESH_S = 5  # the process that made a temporary folder younger than this may be about to lock it
_REFUSED = (
    *(errno.EACCES, errno.EPERM, errno.EROFS, errno.ENAMETOOLONG, errno.EINVAL),
    *(errno.ENOENT, errno.ENOTDIR),  # the folder is gone
    errno.EFBIG,  # of the disk (4 GB on FAT), or `ulimit -f`
)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Turn an OSError in writing `path` into an error that names it;
    errors about other files, such as those read meanwhile, pass unchanged."""
    try:
        yield
    except OSError as problem:
        files = [file for file in (problem.filename, problem.filename2) if isinstance(file, str)]
        if files and not any(_may_be_of(file, path) for file in files):
            raise
        if full := as_disk_full(problem, path):
            raise full from None
        if problem.errno in _REFUSED:
            raise BadInput(f"{path} could not be written: {problem.strerror}.", "Write to another folder.") from None
        raise


def _may_be_of(file: str, path: Path) -> bool:
    """Whether a file that the system refused is a part of `path`, of its temporary folder, or of the folders above."""
    refused = Path(file).absolute()
    return TEMPORARY in file or refused.is_relative_to(path.absolute()) or path.absolute().is_relative_to(refused)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path to write, which becomes `path` if the block ends without an error, and is removed otherwise.

    It lies in a temporary folder beside `path`, because a rename is atomic only on the same disk, and has the same
    name, because writers of videos and pictures choose the format by the suffix.
    Raises DiskFull, and BadInput for a folder that is missing or may not be written.
    """
    check_target(path)
    with _named(path), temporary_folder(path) as work:
        yield work / path.name
        os.replace(work / path.name, path)


class MadeMeanwhile(BadInput):
    """Another program made the folder in the meantime."""


@contextmanager
def made(folder: Path, may_exist: bool = True) -> Iterator[None]:
    """Make `folder`, with its parents, for the block; at the end, those that were made and are still empty are removed.
    Raises OSError if it cannot be made, or exists though it must not."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=may_exist)
    try:
        yield
    finally:
        for path in missing:
            with suppress(OSError):  # a folder that holds files stays
                path.rmdir()


def _not_made(folder: Path, problem: OSError) -> BadInput:
    """The error for a folder of results that the system refuses to make."""
    return BadInput(f"The folder {folder} could not be made: {problem.strerror}.", "Choose another -o.")


@contextmanager
def made_for_user(folder: Path, may_exist: bool = True) -> Iterator[None]:
    """As `made`, for a folder that the user chose: BadInput if it cannot be made,
    but FileExistsError if something is there though nothing may be."""
    with ExitStack() as stack:
        try:
            stack.enter_context(made(folder, may_exist))
        except OSError as problem:
            if not may_exist and isinstance(problem, FileExistsError):
                raise
            raise _not_made(folder, problem) from None
        yield


def parent_for(path: Path) -> Path:
    """Where a temporary folder for `path` lies: beside it, or inside if `path` is a folder. That may be a disk of its
    own (a container's volume), onto which nothing could be renamed from beside it."""
    return path if path.is_dir() else path.parent


@contextmanager
def temporary_folder(path: Path) -> Iterator[Path]:
    """A temporary folder in `parent_for` the path, removed at the end. After a kill it is removed when the next one for
    `path` is made, if the disk supports locks."""
    parent = parent_for(path)
    with made(parent):
        prefix = f".{path.resolve().name[:NAME_PART]}{TEMPORARY}"
        others = _sweep(parent, prefix)
        work = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
        try:
            with taken(work):
                yield work
        finally:
            shutil.rmtree(work, ignore_errors=True)
            if others:
                _sweep(parent, prefix)  # by now, what a kill left just before this began is old enough


def _sweep(parent: Path, prefix: str) -> bool:
    """Remove the temporary folders that killed processes left.
    Returns whether others stay: in use, or too young to tell."""
    with suppress(OSError):  # if the parent is gone by now
        left = [parent / name for name in os.listdir(parent) if name.startswith(prefix) and not name.endswith(KEPT)]
        return sum(swept(folder, remove) for folder in left) < len(left)
    return False


def swept(folder: Path, discard: Callable[[Path], None]) -> bool:
    """Remove `folder`, by `discard`, if its process was killed: nobody has locked it or is about to.
    Returns whether it was removed."""
    with suppress(OSError):
        # Asked first: while it is locked here, its process could not lock it.
        if time.time() - folder.stat().st_mtime <= FRESH_S:
            return False
        with taken(folder) as ours:
            if ours:
                discard(folder)
                return True
    return False


@contextmanager
def replacing_folder(output: Path) -> Iterator[Path]:
    """A temporary folder; the contents of its subfolder scene/ become those
    of `output` if the block ends without an error.

    output: a folder that does not exist yet, or is empty. Raises MadeMeanwhile if that is no longer so at the end,
    DiskFull, and BadInput for a folder that may not be written.
    """
    is_there = output.is_dir()
    with ExitStack() as stack:
        try:
            work = stack.enter_context(temporary_folder(output))
        except OSError as problem:
            raise _not_made(output, problem) from None
        try:
            with _named(output), named_if_full(work, disk_full(output)):
                yield work
                if is_there:
                    if files_in(output):
                        raise OSError(errno.ENOTEMPTY, os.strerror(errno.ENOTEMPTY), str(output))
                    for part in sorted((work / "scene").iterdir(), key=_is_model):
                        os.replace(part, output / part.name)
                else:
                    os.replace(work / "scene", output)
        except DiskFull as problem:  # the user knows nothing of temporary folders
            raise disk_full(output) if TEMPORARY in problem.what else problem from None
        except OSError as problem:
            if problem.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
            raise MadeMeanwhile(
                f"{output} was made by another program meanwhile.", "Use that one, or choose another -o."
            ) from None


def _is_model(part: Path) -> bool:
    """Whether it is the part that makes a folder a scene, which is therefore moved last."""
    return part.name == "sparse"


def temporary_root() -> Path:
    """The system's folder for temporary files; raises WegsError if there is none that can be written in."""
    try:
        return Path(tempfile.gettempdir())
    except FileNotFoundError:  # also where every disk is full
        raise WegsError(
            "There is no folder for temporary files that can be written in.", "Free some space, or set TMPDIR to one."
        ) from None


@contextmanager
def scratch(name: str) -> Iterator[Path]:
    """As `temporary_folder`, among the system's temporary files; `name` says what it is for.
    Raises DiskFull if their disk is full."""
    place = temporary_root()
    what = f"The disk is full: temporary files could not be written in {place}."
    full = DiskFull(what, "Free some space, or set TMPDIR to a folder on another disk.")
    with temporary_folder(place / f"wegs-{name}") as folder, named_if_full(folder, full):
        try:
            yield folder
        except OSError as problem:
            # Not another disk, such as a log's.
            if as_disk_full(problem) and str(problem.filename).startswith(str(folder)):
                raise full from None
            raise


@contextmanager
def named_if_full(folder: Path, full: DiskFull) -> Iterator[None]:
    """Raise `full` instead of any error that occurs while the disk of `folder` is full:
    pycolmap and SQLite report that in their own words."""
    try:
        yield
    except WegsError:
        raise
    except Exception:
        if folder.exists() and shutil.disk_usage(folder).free < 1 << 20:
            raise full from None
        raise


@contextmanager
def filling(folder: Path, patterns: tuple[str, ...], force: bool) -> Iterator[Path]:
    """A temporary folder to fill; its contents become those of `folder` if the block ends without an error,
    and are removed otherwise.

    patterns: globs of what such a block writes. Raises BadInput, before anything is made, if `folder` has files. With
    `force`, files that match are replaced; others are still refused.
    """
    check_fillable(folder, patterns, force)
    with adding(folder) as work:
        yield work
        old = check_fillable(folder, patterns, force)  # another program may have filled it meanwhile
        fresh = {folder / path.name for path in work.iterdir()}
    with _named(folder):
        for path in set(old) - fresh:  # last, so that a kill leaves no file missing
            remove(path)


@contextmanager
def adding(folder: Path) -> Iterator[Path]:
    """A temporary folder to fill; its contents are moved into `folder`, in place of those of the same names, if the
    block ends without an error, and are removed otherwise."""
    with _named(folder), temporary_folder(folder) as work:
        try:
            yield work
        except WegsError as problem:  # the user knows nothing of the temporary folder
            raise type(problem)(problem.what.replace(str(work), str(folder)), problem.fix) from None
        folder.mkdir(exist_ok=True)
        fresh = [path.name for path in work.iterdir()]
        aside = Path(tempfile.mkdtemp(dir=work))
        for name in fresh:
            if (folder / name).is_dir():  # which os.replace replaces only if it is empty
                os.replace(folder / name, aside / name)
            os.replace(work / name, folder / name)


def remove(path: Path) -> None:
    """Delete a file, a link or a folder with all that it holds."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 text file, whole or not at all."""
    write_bytes(path, text.encode())


def write_json(path: Path, value: Any) -> None:
    """Write indented JSON, whole or not at all."""
    text = json.dumps(value, indent=1, ensure_ascii=False) + "\n"
    write_bytes(path, text.encode(errors="backslashreplace"))  # for undecodable bytes of file names
