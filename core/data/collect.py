"""From what a scene's files say to a Collection: photos get cameras, a split and the scene frame."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from core.data.collection import ASTRAY_RATIO, CHECK_POSES, LEAST_SHOWN, Collection, Photo, astray, looks_away
from core.data.given_masks import with_masks_by_name
from core.data.photos.folder import copies_among
from core.data.placing import Placing
from core.data.posed import Points, Posed
from core.data.split import Split, none_held_out, split_photos
from core.errors import BadInput, command
from core.scene.frame import SceneFrame
from core.words import Note, counted, name_them

NO_POINTS = "No points are given with the cameras: `wegs train` triangulates them from the photos."
UNSEEN_POINTS = "Nothing says which photo sees which point, so what the photos need cannot be judged by their colours."


def collect(root: Path, posed: Posed, all_photos: bool) -> Collection:
    """The collection of the posed photos below `root`. all_photos: hold none of them out.

    Photos that are missing, unreadable or of another shape than their camera are left out and noted. The frame is that
    of the points or, without points, of the cameras. Raises BadInput if no photo is left, or none to train on.
    """
    placing = Placing(posed.missing_words)
    named = {photo.name: photo for photo in sorted(posed.photos, key=lambda photo: photo.name)}
    placed = {name: found for name, photo in named.items() if (found := placing.place(photo))}
    if not placed:
        anew = (
            f"Correct {posed.source}, or have the cameras found anew: {command('wegs', 'sfm', 'PHOTOS', '-o', 'SCENE')}"
        )
        raise _unusable(f"No photo of {posed.source} can be used", posed, placing, anew)
    split = _split(root, posed, list(placed))
    if not split.of_photo or not (all_photos or "train" in split.of_photo.values()):
        more = ", or train on what is held out with --all-photos" if split.of_photo else ""
        fix = f"Correct or remove {split.source.name}{more}."
        raise _unusable(f"{split.source} leaves no photo to train on", posed, placing, fix, split.notes)
    points, points_notes = _points(posed)
    centres = np.array([found.camera.centre for found in placed.values()])
    frame = SceneFrame.around(points.positions if len(points.positions) else centres)
    seen = points.seen or {}
    nothing = np.empty(0, np.int64)
    photos = tuple(
        Photo(
            name,
            named[name].path,
            found.camera.in_scene(frame),
            split.of_photo[name],
            seen.get(name, nothing),
            found.lens,
        )
        for name, found in placed.items()
        if name in split.of_photo
    )
    notes = posed.notes + placing.notes() + split.notes + points_notes
    notes += [Note(line, harmless=True) for line in frame.offset_lines()] + _copies_held_out(photos)
    notes += name_them(
        "without any SfM point", [photo.name for photo in photos if photo.name in seen and not len(photo.points)]
    )
    far = [photo.name for photo, is_far in zip(photos, astray(photos), strict=True) if is_far]
    notes += name_them(
        f"whose camera stands over {ASTRAY_RATIO:.0f} times as far off as is usual, used all the same",
        far,
        harmless=True,
        of_cameras=True,
    )
    positions = frame.to_scene(points.positions)
    notes += _contradicted(photos, positions)
    collection = Collection(
        name=root.resolve().name,
        root=root,
        kind=posed.kind,
        photos=photos,
        points=positions,
        point_colours=points.colours,
        frame=frame,
        notes=tuple(notes),
    )
    collection = collection.undivided() if all_photos else collection
    masks = {name: photo.mask for name, photo in named.items() if photo.mask is not None}
    return with_masks_by_name(collection, masks, posed.source) if masks else collection


def _unusable(what: str, posed: Posed, placing: Placing, fix: str, notes: Sequence[Note] = ()) -> BadInput:
    """The error for a scene without usable photos, with what was left out and why.
    fix: what to do if no photos are missing."""
    reasons = "; ".join(note.text.rstrip(".") for note in [*posed.notes, *placing.notes(), *notes] if not note.harmless)
    return BadInput(f"{what}{': ' if reasons else ''}{reasons}.", posed.fix if placing.missing else fix)


def _points(posed: Posed) -> tuple[Points, list[Note]]:
    """The points, which may be none, and a note on what they lack."""
    if posed.points is None:
        return Points(np.zeros((0, 3)), np.zeros((0, 3), np.float32), None), [Note(NO_POINTS, harmless=True)]
    return posed.points, [Note(UNSEEN_POINTS, harmless=True)] if posed.points.seen is None else []


def _contradicted(photos: Sequence[Photo], points: np.ndarray) -> list[Note]:
    """A note if most cameras do not see the points (P, 3) that their photos are said to see."""
    away = sum(looks_away(photo, points) for photo in photos if len(photo.points))
    what = (
        f"{away} of {counted(len(photos), 'camera')} see less than {LEAST_SHOWN:.0%} of the points said to be "
        "theirs: expect a poor scene"
    )
    return [Note(f"{what}. {CHECK_POSES}")] if 2 * away > len(photos) else []


def _copies_held_out(photos: Sequence[Photo]) -> list[Note]:
    by_path = {photo.path: photo for split in ("train", "test") for photo in photos if photo.split == split}
    pairs = [(by_path[copy], by_path[original]) for copy, original in copies_among(by_path).items()]
    names = [
        f"{copy.name} ({original.name})"
        for copy, original in pairs
        if (copy.split, original.split) == ("test", "train")
    ]
    return name_them("held out though a copy of a training photo, so figures are too good", names, of_split=True)


def _split(root: Path, posed: Posed, names: list[str]) -> Split:
    """The split of the placed photos: as the scene's files say or, if they say nothing, as `split_photos`."""
    said = {photo.name: photo.split for photo in posed.photos if photo.split}
    if not said:
        return split_photos(root, posed.source, names, {photo.name for photo in posed.photos})
    of_photo = {name: said[name] for name in names}
    why = f"{posed.source.name} holds out no photo"
    if "test" in said.values():
        why = "No photo that is held out can be used"
    return Split(of_photo, none_held_out(of_photo, why), posed.source)
