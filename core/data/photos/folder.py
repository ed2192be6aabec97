"""Which photos a folder holds: by suffix, without copies, and where else to look when there are none."""

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path

from core.data.made import digest, holds_run_config, is_of_wegs
from core.errors import BadInput, command
from core.words import list_names

SUFFIXES = (
    ".jpg",
    ".jpeg",
    ".png",
    ".webp",
    ".tif",
    ".tiff",
    ".bmp",
    ".jp2",
    ".jfif",
    ".jpe",
    ".heic",
    ".heif",
    ".hif",
    ".avif",
)
# Formats of cameras and phones that cannot be read; no .gif is a photo.
UNREADABLE_SUFFIXES = (
    ".jxl", ".gif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf", ".pef", ".srw",
)  # fmt: skip
VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v")
LEVELS = 3  # how deep to look for photos in subfolders: phone scanners nest theirs that deep
START_BYTES = 1 << 16  # of files of one size, compared before the whole of them


def list_photos(folder: Path) -> list[Path]:
    """The files in `folder` (not below) with a photo's suffix, by name. Hidden files are not photos."""
    return _list_files(folder, SUFFIXES)


def list_unreadable(folder: Path) -> list[Path]:
    """The files in `folder` in formats that cannot be read, by name."""
    return _list_files(folder, UNREADABLE_SUFFIXES)


def list_gone(folder: Path) -> list[Path]:
    """The links in `folder` that are named as photos but lead to nothing, by name."""
    return _list_files(folder, SUFFIXES, lambda path: path.is_symlink() and not path.exists())


def _list_files(folder: Path, suffixes: tuple[str, ...], chosen: Callable[[Path], bool] = Path.is_file) -> list[Path]:
    files = (path for path in folder.iterdir() if path.suffix.lower() in suffixes and not path.name.startswith("."))
    return sorted(filter(chosen, files), key=lambda path: path.name)


def copies_among(paths: Iterable[Path]) -> dict[Path, Path]:
    """Each file that equals an earlier one of `paths` byte for byte -> that one.
    Only files with the same start are read to the end."""
    copies: dict[Path, Path] = {}
    for same_size in _alike(paths, lambda path: path.stat().st_size):
        for same_start in _alike(same_size, lambda path: digest(path, START_BYTES)):
            for original, *others in _alike(same_start, digest):
                copies |= dict.fromkeys(others, original)
    return copies


def _alike(paths: Iterable[Path], key: Callable[[Path], object]) -> list[list[Path]]:
    """The files in groups of the same key, groups of one left out, as are files that cannot be read."""
    groups: dict[object, list[Path]] = {}
    for path in paths:
        with suppress(OSError):  # reported when it is read as a photo
            groups.setdefault(key(path), []).append(path)
    return [group for group in groups.values() if len(group) > 1]


def no_photos(folder: Path) -> BadInput:
    """The error for a folder without photos and model, which says what the folder holds instead."""
    what = "no photos and no COLMAP model"
    name = folder.resolve() if folder == Path() else folder
    if others := list_unreadable(folder):
        suffixes = ", ".join(sorted({path.suffix.lower() for path in others}))
        return BadInput(f"{name} holds only {suffixes} photos, which cannot be read.", "Convert them to JPEG.")
    if holds_run_config(folder):
        return BadInput(f"{name} is a run, whose pictures are not photos.", "Give the folder that holds your photos.")
    if below := photos_below(folder):
        most_first = [str(inner.relative_to(folder)) for inner in sorted(below, key=below.__getitem__, reverse=True)]
        if len(most_first) == 1:
            return BadInput(
                f"{name} holds {what}; there are photos in its folder {most_first[0]}.", "Name that folder."
            )
        fix = "Put all photos into one folder, or name one of these."
        return BadInput(f"{name} holds {what}; there are photos in its folders {list_names(most_first)}.", fix)
    if runs := sorted(path for path in folder.iterdir() if holds_run_config(path)):
        return BadInput(f"{name} holds {what}, but runs such as {runs[0]}.", "Give the folder that holds your photos.")
    if gone := list_gone(folder):
        return BadInput(
            f"{name} holds only links to photos that are gone, such as {gone[0].name}.",
            "Connect their disk, or copy the photos.",
        )
    if videos := _list_files(folder, VIDEO_SUFFIXES):
        return BadInput(f"{name} holds only videos.", take_pictures_out(videos[0]))
    return BadInput(f"{name} holds {what}.", "Give the folder that holds your photos.")


def take_pictures_out(video: Path) -> str:
    """What to do with a video."""
    return f"Take pictures out of it: mkdir photos; {command('ffmpeg', '-i', video, '-vf', 'fps=2', 'photos/%04d.png')}"


def photos_below(folder: Path) -> dict[Path, int]:
    """How many photos are in each folder up to LEVELS below `folder` that holds any; what wegs wrote does not count."""
    counts = {path: len(list_photos(path)) for path in folders_below(folder)}
    return {path: count for path, count in counts.items() if count}


def folders_below(folder: Path, levels: int = LEVELS) -> Iterator[Path]:
    """Subfolders by name, each followed by its own;
    without hidden ones, those that wegs wrote, and those that cannot be listed."""
    with suppress(OSError):
        for path in sorted(folder.iterdir()):
            if (
                path.is_dir()
                and os.access(path, os.R_OK | os.X_OK)
                and not path.name.startswith(".")
                and not is_of_wegs(path)
            ):
                yield path
                if levels > 1:
                    yield from folders_below(path, levels - 1)
