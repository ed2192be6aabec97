"""Points for a transforms.json from the COLMAP model that nerfstudio made it of:
unlike its .ply, that says which photo sees which point."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from core.data.formats.colmap import names_in, nerfstudio_models, posed_photo, read_points
from core.data.formats.model_file import read_model
from core.data.photos.names import rows_that_mean
from core.data.posed import LARGEST_COORDINATE, Points, PosedPhoto
from core.errors import BadInput
from core.words import Note

# How far poses may be apart: in radians, and relative to the distance of the outermost camera from the middle of all.
ALIKE = 0.01
# Of cameras: those that all stand in one place fit no others then, and nothing is divided by zero.
LEAST_SPREAD = 1e-100


def points_of_model(
    root: Path, photos: Sequence[PosedPhoto], image_ids: Mapping[Path, int]
) -> tuple[Points | None, list[Note]]:
    """The points of the COLMAP model below `root` in the frame of the photos, with which photo sees which; and notes.

    image_ids: the model's ids of photos, by path; other photos are matched by name. Of several models, the largest that
    fits is used. None if there is no model, or if it is damaged, has no points, lacks most of the photos or has them in
    other poses, as a note then says.
    """
    faults = []
    for model in nerfstudio_models(root):
        try:
            points, notes = _points(model, photos, image_ids)
            return points, [*notes, Note(f"The points of the COLMAP model {model} are used.", harmless=True)]
        except BadInput as problem:
            faults.append(Note(f"The points of the COLMAP model {model} are not used: {problem.what}"))
    return None, faults[:1]


def _points(model: Path, photos: Sequence[PosedPhoto], image_ids: Mapping[Path, int]) -> tuple[Points, list[Note]]:
    reconstruction = read_model(model)
    points, notes = read_points(reconstruction, model)
    if points is None:
        raise BadInput("it has no usable points.")
    names, _ = names_in(reconstruction)
    posed = {
        name: posed_photo(reconstruction, image, model)
        for number, name in names.items()
        if (image := reconstruction.images[number]).has_pose
    }
    listed, _ = rows_that_mean((photo.path.as_posix() for photo in photos), set(posed))
    of_id = {path: names[number] for path, number in image_ids.items() if number in names}
    found = ((photo.name, of_id.get(photo.path) or listed.get(photo.path.as_posix())) for photo in photos)
    named = {ours: theirs for ours, theirs in found if theirs is not None}
    pairs = [(posed[named[photo.name]], photo) for photo in photos if named.get(photo.name) in posed]
    positions = _moved(points.positions, pairs) if 2 * len(pairs) > len(photos) else None
    if positions is None:
        raise BadInput("its photos or poses are not those of the scene.")
    nothing = {photo.name: np.empty(0, np.int64) for photo in photos}
    seen = points.seen and nothing | {
        ours: points.seen[theirs] for ours, theirs in named.items() if theirs in points.seen
    }
    return Points(positions, points.colours, seen), notes


def _moved(points: np.ndarray, pairs: Sequence[tuple[PosedPhoto, PosedPhoto]]) -> np.ndarray | None:
    """The points (P, 3) after the similarity that takes the first poses of the pairs to the second; None if none does.

    Its rotation follows from the axes of the cameras, which may therefore stand on a line.
    """
    rotations = np.array([there.rotation.T @ here.rotation for here, there in pairs])
    centres, wanted = (np.array([photo.centre for photo in photos]) for photos in zip(*pairs, strict=True))
    if not all((np.abs(numbers) < LARGEST_COORDINATE).all() for numbers in (rotations, centres)):
        return None
    left, _, right = np.linalg.svd(rotations.sum(axis=0))
    turn = left @ right
    middle, wanted_middle = centres.mean(axis=0), wanted.mean(axis=0)
    scale = np.linalg.norm(wanted - wanted_middle) / max(float(np.linalg.norm(centres - middle)), LEAST_SPREAD)

    def move(positions: np.ndarray) -> np.ndarray:
        return scale * (positions - middle) @ turn.T + wanted_middle

    reach = np.linalg.norm(wanted - wanted_middle, axis=1).max()
    astray = np.linalg.norm(move(centres) - wanted, axis=1).max()
    # sqrt(2) times the angle between them, if that is small.
    turned = np.linalg.norm(rotations - turn, axis=(1, 2)).max()
    return move(points) if astray < ALIKE * reach and turned < ALIKE * math.sqrt(2) else None
