"""From what a scene's files say, of whatever kind, to a Collection: photos get their cameras, a split and the scene frame."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from core.data.collection import FAR, Collection, Photo, astray
from core.data.given_masks import with_masks_by_name
from core.data.photos.folder import copies_among
from core.data.placing import LARGEST_COORDINATE, Placing, PosedPhoto
from core.data.split import split_photos
from core.errors import BadInput, command
from core.scene.frame import SceneFrame
from core.words import Note, counted, is_harmless, name_them

STRAY = 1e6  # median distances from the centre; SfM puts some points near infinity, beyond what float32 resolves
CROOKED = 0.01  # by how much axes may differ in length: matrices are often written with three or four digits
NO_POINTS = "No points are given with the cameras: `wegs train` triangulates them from the photos."
UNSEEN_POINTS = "Nothing says which photo sees which point, so what the photos need cannot be judged by their colours."


class Fault(Exception):
    """Why a photo cannot be used, in words that follow "3 photos"."""


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

    missing_words: what to say of missing photos, after "3 photos". fix: what to do if they are missing and none is left.
    """

    kind: str
    source: Path
    photos: list[PosedPhoto]
    points: Points | None
    missing_words: str
    fix: str
    notes: list[str] = field(default_factory=list)


def collect(root: Path, posed: Posed, all_photos: bool = False) -> Collection:
    """The collection of the posed photos below `root`. all_photos: hold none of them out.

    Photos that are missing, unreadable or of another shape than their camera are left out and noted. Without points the frame follows
    the cameras. Raises BadInput if no photo is left, or none to train on.
    """
    placing = Placing(posed.missing_words)
    named = {photo.name: photo for photo in sorted(posed.photos, key=lambda photo: photo.name)}
    placed = {name: found for name, photo in named.items() if (found := placing.place(photo))}
    if not placed:
        anew = f"Correct {posed.source}, or have the cameras found anew: {command('wegs', 'sfm', 'PHOTOS', '-o', 'SCENE')}"
        raise _unusable(f"No photo of {posed.source} can be used", posed, placing, anew)
    splits, split_notes, source = _split(root, posed, list(placed))
    if not splits or not (all_photos or "train" in splits.values()):
        fix = f"Correct or remove {source.name}" + (", or train on what is held out with --all-photos." if splits else ".")
        raise _unusable(f"{source} leaves no photo to train on", posed, placing, fix, split_notes)
    points, points_notes = posed.points, []
    if points is None:
        points, points_notes = Points(np.zeros((0, 3)), np.zeros((0, 3), np.float32), None), [Note(NO_POINTS, harmless=True)]
    elif points.seen is None:
        points_notes = [Note(UNSEEN_POINTS, harmless=True)]
    centres = np.array([found.camera.centre for found in placed.values()])
    frame = SceneFrame.around(points.positions if len(points.positions) else centres)
    seen = points.seen or {}
    nothing = np.empty(0, np.int64)
    photos = tuple(
        Photo(
            name,
            named[name].path,
            found.camera.in_scene(frame),
            splits[name],
            seen.get(name, nothing),
            found.lens,
        )
        for name, found in placed.items()
        if name in splits
    )
    notes = posed.notes + placing.notes() + split_notes + points_notes + frame.offset_notes()
    notes += _copies_held_out(photos)
    notes += name_them("without any SfM point", [photo.name for photo in photos if not len(seen.get(photo.name, [0]))])
    far = [photo.name for photo, is_far in zip(photos, astray(photos), strict=True) if is_far]
    notes += name_them(f"whose camera stands over {FAR:.0f} times as far off as is usual, used all the same", far, harmless=True)
    collection = Collection(root.resolve().name, root, posed.kind, photos, frame.to_scene(points.positions), points.colours, frame, tuple(notes))
    masks = {name: photo.mask for name, photo in named.items() if photo.mask is not None}
    collection = with_masks_by_name(collection, masks, posed.source) if masks else collection
    return collection.undivided() if all_photos else collection


def _unusable(what: str, posed: Posed, placing: Placing, fix: str, notes: Sequence[str] = ()) -> BadInput:
    """The error for a scene without usable photos, with what was left out and why. fix: what to do if no photos are missing."""
    reasons = "; ".join(note.rstrip(".") for note in [*posed.notes, *placing.notes(), *notes] if not is_harmless(note))
    return BadInput(f"{what}{': ' if reasons else ''}{reasons}.", posed.fix if placing.missing else fix)


def _copies_held_out(photos: Sequence[Photo]) -> list[Note]:
    by_path = {photo.path: photo for split in ("train", "test") for photo in photos if photo.split == split}
    pairs = [(by_path[copy], by_path[original]) for copy, original in copies_among(by_path).items()]
    names = [f"{copy.name} ({original.name})" for copy, original in pairs if (copy.split, original.split) == ("test", "train")]
    return [Note(line, of_split=True) for line in name_them("held out though a copy of a training photo, so figures are too good", names)]


def _split(root: Path, posed: Posed, names: list[str]) -> tuple[dict[str, str], list[str], Path]:
    """The split of each placed photo, notes, and the file that says so: that of the posed photos, or if they have none, as `split_photos`."""
    said = {photo.name: photo.split for photo in posed.photos if photo.split}
    if not said:
        return split_photos(root, posed.source, names, {photo.name for photo in posed.photos})
    splits = {name: said[name] for name in names if name in said}
    notes = []
    if "train" in splits.values() and "test" not in splits.values():
        why = "No photo that is held out can be used" if "test" in said.values() else f"{posed.source.name} holds out no photo"
        notes.append(f"{why}: quality on unseen photos cannot be measured.")
    return splits, notes, posed.source


def usable_points(positions: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """(P,) bool: which of the points (P, 3) have usable coordinates; and a note on the others."""
    finite = (np.abs(positions) < LARGEST_COORDINATE).all(axis=1)  # so that NaN fails it
    if finite.any():
        frame = SceneFrame.around(positions[finite], quantile=0.5)
        finite[finite] = np.linalg.norm(frame.to_scene(positions[finite]), axis=1) < STRAY
    dropped = int((~finite).sum())
    return finite, ([f"{counted(dropped, 'point')} at NaN, infinite or absurd coordinates left out."] if dropped else [])


def from_camera_to_world(matrix: np.ndarray, what: str) -> tuple[np.ndarray, np.ndarray]:
    """A camera-to-world matrix (4, 4) or (3, 4) as PosedPhoto.rotation and PosedPhoto.centre, in the camera axes that it has.

    Axes may share a length other than 1: a scaled camera sees the same. Rounded axes are made orthonormal (the nearest rotation, by SVD).
    Raises Fault if it is no rotation otherwise. what: the matrix, in words for the Fault.
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
