"""Fits cameras to photo files: scales them, turns them as EXIF says, or leaves photos out and says why."""

from dataclasses import dataclass, field

import numpy as np
import pycolmap

from core.data.photos import distortion
from core.data.photos.file import Header, named_with_fault, probe
from core.data.photos.names import is_file
from core.data.posed import LARGEST_COORDINATE, PosedPhoto
from core.errors import BadInput
from core.scene.camera import Camera
from core.scene.lens import Lens
from core.words import Note, Reasons, counted, name_them

ASPECT_TOLERANCE = 0.005  # sizes are rounded to whole pixels, on top of that
OFF_MIDDLE = 0.25  # of a side: principal points of photos of another size than the intrinsics are for
USUAL_FOCAL_LENGTHS = (8 / 36, 600 / 36)  # over the longer side: from fisheye to telephoto, mm on a frame 36 mm wide


@dataclass(frozen=True)
class Placed:
    """camera: a pinhole in world units, at the size the photo has as displayed. lens: as in Photo."""

    camera: Camera
    lens: Lens | None


@dataclass
class Placing:
    """Places photos one by one, and collects what to tell the user about them.

    missing_words: what to say of missing photos, after "3 photos".
    """

    missing_words: str
    said: Reasons = field(default_factory=Reasons)
    placed: int = 0
    undistorted: int = 0
    unusual: list[str] = field(default_factory=list)
    off_middle: list[pycolmap.Camera] = field(default_factory=list)  # of no stated size
    missing: int = 0

    def place(self, photo: PosedPhoto) -> Placed | None:
        """The camera fitted to the photo's file, or None; the reason goes into the notes."""
        if not is_file(photo.path):
            self.missing += 1
            self.said.add(self.missing_words, photo.name)
            return None
        try:
            header = probe(photo.path)
        except BadInput as problem:
            self.said.add("unreadable, not used", named_with_fault(photo.name, photo.path, problem))
            return None
        lens = photo.lens(header.width, header.height)
        if lens.is_spherical():
            self.said.add(f"taken by a panorama camera ({lens.model_name}), not used", photo.name)
            return None
        pose = np.vstack([photo.rotation, photo.centre])
        if not (distortion.is_usable(lens) and (np.abs(pose) < LARGEST_COORDINATE).all()):
            self.said.add("with a camera or pose that is broken, not used", photo.name)
            return None
        return self._fit(photo, lens, header)

    def _fit(self, photo: PosedPhoto, lens: pycolmap.Camera, header: Header) -> Placed | None:
        """The camera scaled to the photo. Programs that find cameras ignore EXIF rotation, so a camera that fits the
        pixels as stored is taken for theirs, and is turned together with them."""
        stored = _same_shape(lens, header.width, header.height)
        if not stored and not _same_shape(lens, *header.displayed):
            sizes = f"{header.width}x{header.height}, camera {lens.width}x{lens.height}"
            self.said.add("of another shape than the camera says, not used", f"{photo.name} ({sizes})")
            return None
        orientation = header.orientation if stored else 1
        if orientation not in distortion.TURNS:
            self.said.add("mirrored by EXIF orientation, not used", photo.name)
            return None
        width, height = (header.width, header.height) if stored else header.displayed
        camera = Camera(photo.rotation, photo.centre, *distortion.pinhole(lens, width, height), width, height)
        distorted = not distortion.is_pinhole(lens)
        self.undistorted += distorted
        if orientation != 1:
            self.said.add("turned by EXIF orientation, camera and all", photo.name, harmless=True)
            camera = distortion.turned(camera, orientation)
        self.placed += 1
        x, y = lens.principal_point_x / lens.width, lens.principal_point_y / lens.height
        if max(abs(x - 0.5), abs(y - 0.5)) > OFF_MIDDLE and not photo.has_size():
            self.off_middle.append(lens)
        if not is_usual(lens):
            self.unusual.append(f"{photo.name} ({camera.fx:.3g} px at a width of {camera.width})")
        return Placed(camera, distortion.lens_of(lens, orientation) if distorted else None)

    def notes(self) -> list[Note]:
        """One line for each reason that occurred."""
        undistorted = f"{counted(self.undistorted, 'photo')} will be undistorted."
        few = 2 * len(self.unusual) <= self.placed
        many = f"of {self.placed} with a focal length that no lens has, so expect a poor scene"
        what = "with an unusual focal length, used all the same" if few else many
        notes = self.said.notes() + name_them(what, self.unusual, harmless=few, of_cameras=True)
        notes += self._of_another_size()
        return [*notes, Note(undistorted, harmless=True)] if self.undistorted else notes

    def _of_another_size(self) -> list[Note]:
        """A note if the principal points say that the intrinsics of most photos are for another size."""
        if 2 * len(self.off_middle) <= self.placed:
            return []
        lens = self.off_middle[0]
        meant = f"{2 * lens.principal_point_x:.0f} x {2 * lens.principal_point_y:.0f}"
        what = (
            f"The intrinsics fit photos of about {meant} px (twice the principal point), "
            f"the files have {lens.width} x {lens.height}"
        )
        return [
            Note(
                f"{what}: expect a poor scene. Put in photos of that size, "
                "or state w and h where the file may (transforms.json)."
            )
        ]


def focal_length_of(camera: Camera | pycolmap.Camera) -> float:
    """The mean of both focal lengths over the longer side."""
    return camera.mean_focal_length() / max(camera.width, camera.height)


def is_usual(camera: Camera | pycolmap.Camera) -> bool:
    """Whether lenses of this focal length exist."""
    low, high = USUAL_FOCAL_LENGTHS
    return low <= focal_length_of(camera) <= high


def _same_shape(lens: pycolmap.Camera, width: int, height: int) -> bool:
    """Whether a photo of this size can be the camera's picture, scaled."""
    tolerance = ASPECT_TOLERANCE + 1.5 / min(width, height)
    return abs(np.log(width * lens.height / (height * lens.width))) <= tolerance
