"""COLMAP folders: a model and the photos it was made from, at whatever size they are found."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap

from core.data import lens as lenses
from core.data.collection import FAR, Collection, Photo, astray
from core.data.model_file import holds_model, lacking_files, read_model
from core.data.photo_file import Header, list_photos, named_with_fault, probe
from core.data.split import counted, name_them, split_photos
from core.errors import BadInput
from core.scene.camera import Camera
from core.scene.frame import SceneFrame

MODEL_FOLDERS = ("sparse/0", "sparse", "dense/sparse/0", "dense/sparse")
SHRUNKEN = ("images_2", "images_4", "images_8")  # copies that the original project and its data sets keep
ASPECT_TOLERANCE = 0.005  # sizes are rounded to whole pixels, on top of that
LARGEST = 1e100  # a coordinate; the square of a larger one may be infinite
STRAY = 1e6  # median distances from the middle; SfM puts points near infinity, and float32 ends there
USUAL_FOCAL_LENGTHS = (0.1, 10.0)  # in lengths of the longer side: COLMAP's own bounds


def find_model(root: Path) -> Path | None:
    """The folder of the COLMAP model below `root`, or None; BadInput where files of it are missing."""
    folders = [root / name for name in MODEL_FOLDERS]
    folders += [folder for base in ("sparse", "dense/sparse") for folder in _numbered(root / base)]
    for folder in folders:
        if holds_model(folder):
            return folder
    for folder in folders:
        if lacking := lacking_files(folder):
            fix = "Copy it again, or remove the folder to have the cameras found anew."
            raise BadInput(f"The COLMAP model in {folder} lacks {', '.join(lacking)}.", fix)
    return None


def _numbered(folder: Path) -> list[Path]:
    """The models that COLMAP writes where the photos fell apart, 0, 1, ...: in no order of size."""
    found = [path for path in folder.iterdir() if path.name.isdecimal()] if folder.is_dir() else []
    return sorted(found, key=lambda path: int(path.name))


def load_colmap(root: Path, model: Path, kind: str) -> Collection:
    """The collection of the COLMAP `model` below `root`, its photos in images/, images_N/ or beside.

    Cameras are scaled to the photos found and, where the photo on disk is distorted, stand for its undistorted picture.
    Photos that are missing, unreadable, without a pose or of another shape than their camera are left out and noted.
    Raises BadInput for a damaged model, one without points, and where no photo is left.
    """
    reconstruction = read_model(model)
    found = sorted((image for image in reconstruction.images.values() if image.has_pose), key=lambda image: image.name)
    if not found:
        raise BadInput(f"{model} has no photos with a pose.", "Run COLMAP again, or type: wegs sfm PHOTOS -o SCENE")
    points, colours, seen, notes = _points(reconstruction, model)
    notes += _other_models(model)
    images = _images_folder(root, model, [image.name for image in found])
    reading = _Reading(images)
    posed = {image.name: photo for image in found if (photo := reading.photo(image))}
    if not posed:
        fix = f"Put the photos into {root / 'images'}, named as in the model."
        raise BadInput(f"No photo of {model} can be used: {'; '.join(reading.notes())}.", fix)
    extra = {path.name for path in list_photos(images)} - {image.name for image in found}
    notes += reading.notes() + name_them(f"in {images} without a pose, not used", sorted(extra))
    splits, split_notes = split_photos(root, sorted(posed), {image.name for image in found})
    notes += split_notes
    frame = SceneFrame.around(points)
    notes += frame.offset_notes()
    nothing = np.empty(0, np.int64)
    photos = tuple(
        Photo(
            name,
            images / name,
            posed[name].camera.in_scene(frame),
            splits[name],
            seen.get(posed[name].image_id, nothing),
            posed[name].lens,
        )
        for name in sorted(posed)
        if name in splits
    )
    blind = [photo.name for photo in photos if not len(photo.points)]
    notes += name_them("that see no SfM point", blind)
    far = [photo.name for photo, is_far in zip(photos, astray(photos), strict=True) if is_far]
    notes += name_them(f"whose camera stands over {FAR:.0f} times as far off as is usual, used all the same", far)
    return Collection(root.resolve().name, root, kind, photos, frame.to_scene(points), colours, frame, tuple(notes))


def _points(
    reconstruction: pycolmap.Reconstruction, model: Path
) -> tuple[np.ndarray, np.ndarray, dict[int, np.ndarray], list[str]]:
    """Usable points (P, 3) in world units, colours (P, 3) in [0, 1], the points each image id sees, notes."""
    # By id: pycolmap's own order is that of a hash table, and a run must begin the same each time.
    points = [point for _, point in sorted(reconstruction.points3D.items(), key=lambda item: item[0])]
    positions = np.array([point.xyz for point in points], np.float64).reshape(-1, 3)
    finite = (np.abs(positions) < LARGEST).all(axis=1)  # so that NaN fails it
    if finite.any():
        frame = SceneFrame.around(positions[finite], quantile=0.5)
        finite[finite] = np.linalg.norm(frame.to_scene(positions[finite]), axis=1) < STRAY
    if not finite.any():
        usable = f" at usable coordinates, of {len(points)}" if points else ""
        raise BadInput(f"{model} has no 3D points{usable}.", "Run COLMAP's triangulation, or type: wegs sfm PHOTOS -o SCENE")
    kept = [point for point, good in zip(points, finite, strict=True) if good]
    colours = np.array([point.color for point in kept], np.float32) / 255
    seen: dict[int, list[int]] = {}
    for index, point in enumerate(kept):
        for element in point.track.elements:
            seen.setdefault(element.image_id, []).append(index)
    dropped = len(points) - len(kept)
    notes = [f"{counted(dropped, 'point')} at NaN, infinite or absurd coordinates left out."] if dropped else []
    # An image may see a point twice.
    return positions[finite], colours, {image: np.unique(indices) for image, indices in seen.items()}, notes


def _other_models(model: Path) -> list[str]:
    if not model.name.isdecimal():
        return []
    others = [folder.name for folder in _numbered(model.parent) if folder != model and holds_model(folder)]
    return [f"{model.parent} holds other models as well ({', '.join(others)}); {model.name} is used."] if others else []


def _images_folder(root: Path, model: Path, names: list[str]) -> Path:
    """The folder that holds most of the model's photos: images/, images_N/, the same below dense/, or root itself."""
    near = model.parent.parent if model.name.isdecimal() else model.parent
    candidates = [base / name for base in (root, near) for name in ("images", *SHRUNKEN)] + [root, near]
    return max(candidates, key=lambda folder: sum((folder / name).is_file() for name in names))  # the first of equals


@dataclass
class _Posed:
    """A photo with its camera, in world units."""

    image_id: int
    camera: Camera
    lens: dict | None


@dataclass
class _Reading:
    """Turns the images of a model into posed photos, and remembers which it could not, and why."""

    images: Path
    missing: list[str] = field(default_factory=list)
    unreadable: list[str] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)
    misfits: list[str] = field(default_factory=list)
    mirrored: list[str] = field(default_factory=list)
    rotated: list[str] = field(default_factory=list)
    extreme: list[str] = field(default_factory=list)
    undistorted: int = 0

    def photo(self, image: pycolmap.Image) -> _Posed | None:
        """The image's photo with its camera, or None, with the name put on the list that says why."""
        path = self.images / image.name
        if not path.is_file():
            self.missing.append(image.name)
            return None
        try:
            header = probe(path)
        except BadInput as problem:
            self.unreadable.append(named_with_fault(image.name, path, problem))
            return None
        pose = image.cam_from_world().matrix()
        if not lenses.usable(image.camera) or not (np.abs(pose) < LARGEST).all():
            self.broken.append(image.name)
            return None
        return self._fit(image, header, pose)

    def _fit(self, image: pycolmap.Image, header: Header, pose: np.ndarray) -> _Posed | None:
        """The camera scaled to the photo. COLMAP ignores EXIF rotation, so where the model's size fits the pixels as
        stored, its camera is that of the stored pixels, and is turned together with them."""
        lens = image.camera
        stored = _same_shape(lens, header.width, header.height)
        if not stored and not _same_shape(lens, *header.displayed):
            self.misfits.append(f"{image.name} ({header.width}x{header.height}, camera {lens.width}x{lens.height})")
            return None
        orientation = header.orientation if stored else 1
        if orientation not in lenses.TURNS:
            self.mirrored.append(image.name)
            return None
        width, height = (header.width, header.height) if stored else header.displayed
        rotation = pose[:, :3]
        camera = Camera(rotation, -rotation.T @ pose[:, 3], *lenses.pinhole(lens, width, height), width, height)
        description = None
        if not lenses.is_pinhole(lens):
            self.undistorted += 1
            description = lenses.describe(lens)
        if orientation != 1:
            self.rotated.append(image.name)
            camera = lenses.turned(camera, orientation)
            if description is not None:
                description["orientation"] = orientation
        low, high = USUAL_FOCAL_LENGTHS
        if not low <= lens.mean_focal_length() / max(lens.width, lens.height) <= high:
            self.extreme.append(f"{image.name} ({camera.fx:.3g} px at a width of {camera.width})")
        return _Posed(image.image_id, camera, description)

    def notes(self) -> list[str]:
        """One line for each reason that occurred."""
        notes = name_them(f"of the model missing in {self.images}", self.missing)
        notes += name_them("unreadable, not used", self.unreadable)
        notes += name_them("with a camera or pose that is broken or no perspective one, not used", self.broken)
        notes += name_them("of another shape than their camera, not used", self.misfits)
        notes += name_them("mirrored by their EXIF orientation, not used", self.mirrored)
        notes += name_them("turned by their EXIF orientation; their cameras were turned along", self.rotated)
        notes += name_them("with an unusual focal length, used all the same", self.extreme)
        if self.undistorted:
            notes.append(f"{counted(self.undistorted, 'photo')} will be undistorted.")
        return notes


def _same_shape(lens: pycolmap.Camera, width: int, height: int) -> bool:
    """Whether a photo of this size can be the camera's picture, scaled."""
    tolerance = ASPECT_TOLERANCE + 1.5 / min(width, height)
    return abs(np.log(width * lens.height / (height * lens.width))) <= tolerance
