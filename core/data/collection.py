"""What every kind of photo collection is read into."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from core.data.photos.names import composed, names_without_suffixes
from core.errors import BadInput
from core.scene.camera import Camera
from core.scene.frame import SceneFrame
from core.scene.lens import Lens
from core.words import Note, counted, list_names

Item = TypeVar("Item")

LEAST_SHOWN = 0.5  # share of a photo's own points that its camera should see
POINTS_LOOKED_AT = 10_000  # points to look at where no file says which photo sees which: a million take 0.7 s a photo
CHECK_POSES = (
    "Check that its poses are in the axes of its format, or have its cameras found anew: wegs sfm PHOTOS -o SCENE"
)
ASTRAY_RATIO = 100.0  # times the median camera's distance from the scene's centre


@dataclass(frozen=True)
class GivenMask:
    """A mask that came with a photo: a picture, white where training uses the photo (core.data.given_masks).

    lens: that of the photo's original, if the photo is an undistorted copy and the mask was drawn on the original, else
    None. bytes: as `Photo.bytes`.
    """

    path: Path
    lens: Lens | None = None
    bytes: int | None = None


@dataclass(frozen=True)
class Photo:
    """A posed photo. `camera`: a pinhole in the scene frame, at the size of the photo on disk (as displayed).

    lens: that of the file if it is distorted, else None.
    points: indices into Collection.points of the SfM points that it sees; empty for a photo from outside.
    bytes: the size of the file when the run began, for a photo of a run; None if unknown.
    """

    name: str
    path: Path
    camera: Camera
    split: str  # "train" or "test"
    points: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    lens: Lens | None = None
    mask: GivenMask | None = None
    bytes: int | None = None

    @staticmethod
    def from_outside(path: Path, camera: Camera, mask: Path | None) -> "Photo":
        """A photo file that is in no collection. mask: white where it is to be used; all of it for None."""
        return Photo(path.name, path, camera, "test", mask=None if mask is None else GivenMask(mask))

    def same_split_and_camera(self, other: "Photo") -> bool:
        """Whether both have the same split and, up to rounding, which differs between processors, the same camera."""
        same = self.split == other.split and self.lens == other.lens
        return same and np.allclose(self.camera.numbers(), other.camera.numbers(), rtol=0, atol=1e-9)


@dataclass(frozen=True)
class Collection:
    """Posed photos and SfM points, in the scene frame; `frame` leads back to world units.

    root: the scene's own folder. points_from: the folder of the points triangulated for it (`sfm.kept_points`); None if
    it has its own. points: (P, 3) float64. point_colours: (P, 3) float32 in [0, 1]. notes: lines for the user on what
    was dropped or decided, and why.
    """

    name: str
    root: Path
    kind: str
    photos: tuple[Photo, ...]
    points: np.ndarray
    point_colours: np.ndarray
    frame: SceneFrame
    notes: tuple[Note, ...] = ()
    points_from: Path | None = None

    @property
    def read_from(self) -> Path:
        """The folder that `load_collection` reads it from, points and all."""
        return self.points_from or self.root

    def split(self, name: str) -> tuple[Photo, ...]:
        """The photos of one split, by name. Held-out ones come without their masks,
        because quality is measured on the whole photo."""
        photos = tuple(photo for photo in self.photos if photo.split == name)
        return photos if name == "train" else tuple(replace(photo, mask=None) for photo in photos)

    def undivided(self) -> "Collection":
        """The same collection with no photo held out."""
        photos = tuple(replace(photo, split="train") for photo in self.photos)
        notes = [note for note in self.notes if not note.of_split]
        undivided = Note("All photos are trained on, none is held out: there will be no held-out quality.")
        return replace(self, photos=photos, notes=(*notes, undivided))

    def changed_since(self, before: "Collection") -> list[str]:
        """The names of photos that were added or removed, or changed split or camera, since `before`:
        a run cannot be resumed with them."""
        now, then = ({photo.name: photo for photo in one.photos} for one in (self, before))
        both = {name for name in now.keys() & then.keys() if now[name].same_split_and_camera(then[name])}
        return sorted((now.keys() | then.keys()) - both)

    def called(self, name: str) -> Photo | None:
        """The only photo that may be called `name`."""
        photos = self.all_called(name)
        return photos[0] if len(photos) == 1 else None

    def all_called(self, name: str) -> list[Photo]:
        """The photo called `name`; if there is none, those called that without their suffix,
        or else without their folders as well.

        A name with two suffixes may be given without both: structure from motion turns a.png into a.png.jpg.
        """
        if exactly := [photo for photo in self.photos if photo.name == name]:
            return exactly
        wanted = composed(name)
        if nearly := [photo for photo in self.photos if wanted in names_without_suffixes(composed(photo.name))]:
            return nearly
        return [photo for photo in self.photos if wanted in names_without_suffixes(composed(Path(photo.name).name))]

    def check_unambiguous(self, name: str) -> None:
        """Raise BadInput if several photos may be called `name`."""
        if len(photos := self.all_called(name)) > 1:
            names = list_names([photo.name for photo in photos])
            raise BadInput(f"{name} may be {counted(len(photos), 'photo')}: {names}.", "Give the whole name of one.")

    def photo(self, name: str | None) -> Photo:
        """As `called`; for None the first held-out photo, or the first of all.
        Raises BadInput if there is no such photo."""
        if name is None:
            return (self.split("test") or self.photos)[0]
        if (photo := self.called(name)) is not None:
            return photo
        self.check_unambiguous(name)
        raise BadInput(f"There is no photo {name} in this run.", f"Choose another, such as {self.photos[0].name}.")


def spread_over(items: Sequence[Item], count: int) -> Sequence[Item]:
    """`count` of the items (photos, cameras), evenly spread from the first to the last;
    all of them if there are fewer."""
    if len(items) <= count:
        return items
    return [items[row] for row in np.linspace(0, len(items) - 1, count).astype(int).tolist()]


def looks_away(photo: Photo, points: np.ndarray) -> bool:
    """Whether the camera sees less than LEAST_SHOWN of the photo's own points, of all (P, 3);
    if it has none, whether it sees no point at all."""
    if len(photo.points):
        return float(photo.camera.shows(points[photo.points])[0].mean()) < LEAST_SHOWN
    return not photo.camera.shows(points[:: max(1, len(points) // POINTS_LOOKED_AT)])[0].any()


def astray(photos: Sequence[Photo], far: float = ASTRAY_RATIO) -> np.ndarray:
    """(n,) bool: which cameras are more than `far` times as far from the scene's centre as the median camera.

    They are errors of structure from motion: what has to enclose the cameras, such as the sky, leaves them out.
    """
    distances = np.array([np.linalg.norm(photo.camera.centre) for photo in photos])
    return distances > far * np.median(distances)
