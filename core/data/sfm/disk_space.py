"""Checks that the disk has room for what pycolmap writes:
where it cannot write, it ends the program, or silently leaves empty files."""

import errno
import os
import shutil
from pathlib import Path

import pycolmap

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]  # a module that may be missing

SPARE_BYTES = 16 << 20  # that are left on the disk
# In a model's files, at most: a point, a photo that sees it; a photo with its name, a feature of it.
POINT_BYTES, TRACK_BYTES, PHOTO_BYTES, FEATURE_BYTES = 64, 8, 512, 24


def check_room(folder: Path, needed: int, largest: int = 0) -> None:
    """Raise OSError unless `needed` more bytes can be written in `folder`.
    largest: the final size of the largest of these files."""
    if shutil.disk_usage(folder).free < needed + SPARE_BYTES:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))
    if resource and 0 <= resource.getrlimit(resource.RLIMIT_FSIZE)[0] < largest:  # `ulimit -f`; infinity is negative
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(folder))


def check_growth(file: Path, by: int) -> None:
    """Raise OSError unless the file, which need not exist yet, can grow by so many bytes."""
    check_room(file.parent, by, by + (file.stat().st_size if file.exists() else 0))


def write_model(model: pycolmap.Reconstruction, folder: Path) -> None:
    """Write the model into an existing folder; raises OSError if there is no room."""
    points = model.num_points3D() * POINT_BYTES + model.compute_num_observations() * TRACK_BYTES
    photos = sum(PHOTO_BYTES + len(image.points2D) * FEATURE_BYTES for image in model.images.values())
    check_room(folder, points + photos, max(points, photos))
    model.write(folder)
