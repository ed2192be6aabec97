"""What a scene's files say of its photos, cameras and points, of whatever kind they are."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap

from core.scene.frame import SceneFrame
from core.words import Note, counted

LARGEST_COORDINATE = 1e100  # the square of a larger one may be infinite
STRAY = 1e6  # median distances from the centre; SfM puts some points near infinity, beyond what float32 resolves
CROOKED = 0.01  # by how much axes may differ in length: matrices are often written with three or four digits


class Fault(Exception):
    """Why a photo cannot be used, in words that follow "3 photos"."""


@dataclass(frozen=True)
class PosedPhoto:
    """A photo as a collection's files describe it, before the photo itself is opened.

    lens: the camera for a photo of this width and height (px, as stored), which matter only to formats that state no
    size. rotation: (3, 3) world to camera, OpenCV axes. centre: (3,) world units. split: "train", "test", or None if
    the files do not say. mask: a picture, white where the photo is to be used.
    """

    name: str
    path: Path
    lens: Callable[[int, int], pycolmap.Camera]
    rotation: np.ndarray
    centre: np.ndarray
    split: str | None = None
    mask: Path | None = None

    def has_size(self) -> bool:
        """Whether the files state the size of the photo that the camera is of."""
        return self.lens(1, 1).width == self.lens(2, 2).width


@dataclass(frozen=True)
class Points:
    """Points of a scene in world units: positions (P, 3) float64, colours (P, 3) float32 in [0, 1].

    seen: by photo name, the indices of the points it sees; None if unknown.
    """

    positions: np.ndarray
    colours: np.ndarray
    seen: dict[str, np.ndarray] | None


@dataclass(frozen=True)
class Posed:
    """What a scene's files say. source: the file or folder that says it. notes: what was left out so far.

    missing_words: what to say of missing photos, after "3 photos". fix: what to do if they are missing and none is
    left.
    """

    kind: str
    source: Path
    photos: list[PosedPhoto]
    points: Points | None
    missing_words: str
    fix: str
    notes: list[Note] = field(default_factory=list)


def in_utf_8(name: str) -> bool:
    """Whether a photo's name is in UTF-8: COLMAP,
    which triangulates points where a scene has none, accepts no other."""
    return name.encode("utf-8", "replace").decode() == name


def usable_points(positions: np.ndarray) -> tuple[np.ndarray, list[Note]]:
    """(P,) bool: which of the points (P, 3) have usable coordinates; and a note on the others."""
    finite = (np.abs(positions) < LARGEST_COORDINATE).all(axis=1)  # so that NaN fails it
    if finite.any():
        frame = SceneFrame.around(positions[finite], quantile=0.5)
        finite[finite] = np.linalg.norm(frame.to_scene(positions[finite]), axis=1) < STRAY
    dropped = int((~finite).sum())
    note = Note(f"{counted(dropped, 'point')} at NaN, infinite or absurd coordinates left out.")
    return finite, [note] if dropped else []


def from_camera_to_world(matrix: np.ndarray, what: str) -> tuple[np.ndarray, np.ndarray]:
    """A camera-to-world matrix (4, 4) or (3, 4) as PosedPhoto.rotation and PosedPhoto.centre,
    in the camera axes that it has.

    The axes may have a common length other than 1, as a scaled camera sees the same. Rounded axes are replaced by the
    nearest rotation (SVD). Raises Fault for any other matrix that is no rotation. what: the matrix, in words for the
    Fault.
    """
    axes, centre = matrix[:3, :3], matrix[:3, 3]
    if not (np.abs(matrix[:3]) < LARGEST_COORDINATE).all():
        raise Fault(f"with {what} with numbers that are not finite")
    left, lengths, right = np.linalg.svd(axes)
    if not lengths[2] > (1 - CROOKED) * lengths[0]:
        raise Fault(f"with {what} that is not a rotation: its axes differ in length or are not at right angles")
    rotation = left @ right
    if np.linalg.det(rotation) < 0:
        raise Fault(f"with {what} that is mirrored")
    return rotation.T, centre
