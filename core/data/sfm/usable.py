"""Which photos of a folder structure from motion uses:
those that can be read and are large enough, and the fullest of several files of a picture."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from core.data.photos.file import Header, opened
from core.data.photos.folder import copies_among
from core.data.photos.lookalikes import Pictures
from core.data.photos.pixels import read_pixels_and_alpha
from core.errors import BadInput
from core.report import Report

# What decides between files of the same picture, in this order. EXIF has the focal length; programs that make copies
# lengthen names.
LESS = ("with fewer pixels", "without EXIF", "with fewer bytes", "under a longer name", "under a later name")
LONGEST_SIDE_PX = 65_500  # of a JPEG, which COLMAP is given
# COLMAP places a photo by 30 features. Those of plaza, Liberty, Sacré-Cœur and Kermit, shrunk to 40 x 30 px, have 3 to
# 31; to 80 x 60 px, 22 to 108.
LEAST_PIXELS = 40 * 30


@dataclass(frozen=True)
class UsablePhoto:
    """pixels: (H, W, 3) uint8 RGB, as displayed. alpha: (H, W) uint8, None where all is opaque."""

    header: Header
    pixels: np.ndarray
    alpha: np.ndarray | None = None


class StoredTwice(BadInput):
    """There is a fuller file of the same picture."""


def usable_photos(paths: Sequence[Path], report: Report) -> Iterator[tuple[Path, UsablePhoto | BadInput]]:
    """Each photo, the fullest first, or why it is not used; reports progress.
    Photos are always decoded, as some damage shows only then."""
    headers = {path: _header(path) for path in paths}
    ranks = {path.name: _rank(path, headers[path]) for path in paths}
    fullest_first = sorted(paths, key=lambda path: ranks[path.name])
    copies, pictures = copies_among(fullest_first), Pictures()

    def read_once(path: Path) -> UsablePhoto:
        if path in copies:
            raise StoredTwice(f"{path.name} is a copy of {copies[path].name}.")
        photo = _read(path, headers[path])
        if twin := pictures.meet(path.name, photo.pixels):
            ranked = zip(LESS, ranks[path.name], ranks[twin], strict=True)
            less = next(words for words, own, its in ranked if own != its)
            raise StoredTwice(f"{path.name} is the picture {twin} once more, {less}.")
        return photo

    for done, path in enumerate(fullest_first, 1):
        found: UsablePhoto | BadInput
        try:
            found = read_once(path)
        except BadInput as problem:
            found = problem
        yield path, found
        report.progress("Photos", done, len(paths), path.name)


def _header(path: Path) -> Header | BadInput:
    """The header, by which photos are ranked before they are decoded, or why there is none."""
    try:
        with opened(path) as (header, _):
            return header
    except BadInput as problem:
        return problem


def _rank(path: Path, header: Header | BadInput) -> tuple[int, bool, int, int, str]:
    """A key by which the fullest file comes first."""
    if isinstance(header, BadInput):
        return 0, True, 0, len(path.name), path.name
    return -header.width * header.height, not header.exif, -path.stat().st_size, len(path.name), path.name


def _read(path: Path, header: Header | BadInput) -> UsablePhoto:
    if isinstance(header, BadInput):
        raise header
    width, height = header.displayed
    if max(width, height) > LONGEST_SIDE_PX:
        raise BadInput(f"{path} is {width} x {height} px, too large for a JPEG.", "Use a smaller copy.")
    if width * height < LEAST_PIXELS:
        raise BadInput(f"{path} is {width} x {height} px, too small to find features in.", "Use a larger photo.")
    return UsablePhoto(header, *read_pixels_and_alpha(path))
