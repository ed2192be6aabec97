"""transforms.json of nerfstudio and Instant-NGP, and transforms_train.json with its siblings of NeRF's Blender scenes.

Sources: nerfstudio's "Data conventions" page and the parser that it documents; Instant-NGP's docs/nerf_dataset_tips.md;
the Blender scenes of NeRF (Mildenhall et al. 2020). Poses lead from camera to world, with OpenGL axes (x right, y up, z
back).
"""

import json
import math
import os
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pycolmap

from core.data.formats.colmap import NERFSTUDIO_FILE
from core.data.formats.nerfstudio_model import points_of_model
from core.data.formats.point_file import read_points_file
from core.data.found_file import SHRUNKEN, with_files_found
from core.data.photos.folder import SUFFIXES
from core.data.photos.names import is_file, rows_that_mean
from core.data.posed import Fault, Points, Posed, PosedPhoto, from_camera_to_world, in_utf_8, usable_points
from core.data.split import in_both
from core.errors import BadInput
from core.scene.camera import LARGEST_SIDE_PX
from core.words import Note, Reasons, list_names, name_them

BLENDER_FILES = {split: f"transforms_{split}.json" for split in ("train", "test", "val")}
# All read alike, with whatever lens terms are given.
PERSPECTIVE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
FISHEYE = "OPENCV_FISHEYE"
LENGTHS, ANGLES = {"fl_x", "fl_y"}, {"camera_angle_x", "camera_angle_y"}  # which say the focal length
# In the order of nerfstudio's distortion_params, which may stand in their place.
LENS_TERMS = ("k1", "k2", "k3", "k4", "p1", "p2")
TO_OPENCV = np.array([1.0, -1.0, -1.0])  # of the columns of a pose with OpenGL axes
DYNAMIC_MASK = (
    "whose dynamic_mask_*.png (Instant-NGP) is not used: "
    "invert it (white = use), name it as the photo, and give its folder to --masks"
)
IN_VIEW = 0.5  # share of the points; if the cameras see less, the file is probably in another frame
POINTS_ASKED = 10_000  # evenly spread, to find that out


def read_transforms(root: Path) -> Posed:
    """What transforms.json in `root` says, with the split of its train_filenames, test_filenames and val_filenames.

    Raises BadInput for a file that is broken or has no frames, and for a ..._filenames that is not a list of names.
    """
    reading = _Reading(root)
    source = root / NERFSTUDIO_FILE
    facts = _read_json(source)
    if others := [name for name in BLENDER_FILES.values() if (root / name).is_file()]:
        reading.notes.append(Note(f"{root} holds {list_names(others)} as well; {NERFSTUDIO_FILE} is used."))
    photos = reading.split_as_listed(source, facts, reading.photos(source, facts))
    return reading.posed("nerfstudio", source, facts, photos)


def read_blender(root: Path) -> Posed:
    """What transforms_train.json in `root` says; transforms_test.json, or else transforms_val.json, is held out.

    Raises BadInput for a file that is broken, and if there are no frames to train on.
    """
    reading = _Reading(root)
    source = root / BLENDER_FILES["train"]
    facts = _read_json(source)
    training, holding_out = reading.photos(source, facts), source
    held_out: list[PosedPhoto] = []
    there = [root / BLENDER_FILES[split] for split in ("test", "val") if (root / BLENDER_FILES[split]).is_file()]
    for path in there:
        if held_out:
            reading.notes.append(
                Note(f"{path.name} is not used: {holding_out.name} is what is held out.", harmless=True)
            )
        else:
            held_out, holding_out = reading.photos(path, _read_json(path, may_be_empty=True)), path
    both = {photo.path for photo in training} & {photo.path for photo in held_out}
    reading.notes += in_both(source.name, holding_out.name, [path.name for path in both])
    if held_out:
        training = [replace(photo, split="train") for photo in training if photo.path not in both]
    photos = training + [replace(photo, split="test") for photo in held_out]
    return reading.posed("blender", source, facts, photos)


@dataclass
class _Reading:
    """Reads frames, and collects which could not be used and why.
    Photos are named by their whole paths until all are known."""

    root: Path
    notes: list[Note] = field(default_factory=list)
    faults: Reasons = field(default_factory=Reasons)
    sources: list[str] = field(default_factory=list)
    image_ids: dict[Path, int] = field(default_factory=dict)  # of photos, in the COLMAP model

    def photos(self, source: Path, facts: dict) -> list[PosedPhoto]:
        """The usable frames, each photo once."""
        photos: dict[Path, PosedPhoto] = {}
        for number, frame in enumerate(facts["frames"]):
            label = f"frame {number} of {source.name}"
            try:
                if not (isinstance(frame, dict) and frame.get("file_path") and isinstance(frame["file_path"], str)):
                    raise Fault("without a file_path")
                path = self.find(frame["file_path"])
                label = path.name
                if path in photos:
                    self.faults.add("named more than once, used the first time", label)
                    continue
                rotation, centre = _pose(frame)
                lens = _Lens.of(facts, frame)
                mask = frame.get("mask_path")
                if not isinstance(mask, str | None):
                    self.faults.add("with a mask_path that is no name, used whole", label)
                mask = self.find(mask) if isinstance(mask, str) else None
                photos[path] = PosedPhoto(str(path), path, lens.camera, rotation, centre, mask=mask)
                if mask is None and is_file(path.parent / f"dynamic_mask_{path.stem}.png"):
                    self.faults.add(DYNAMIC_MASK, label)
                if isinstance(image_id := frame.get("colmap_im_id"), int):
                    self.image_ids[path] = image_id
            except Fault as fault:
                self.faults.add(f"{fault}, not used", label)
        if photos:
            self.sources.append(source.name)
        return list(photos.values())

    def find(self, name: str) -> Path:
        """The file that a file_path means, relative to the root. Blender scenes omit the suffix."""
        # `..` leads out of the scene's folder, not out of a link to it.
        root = self.root.resolve() if os.pardir in Path(name).parts else self.root
        path = os.path.abspath(root / name)
        if is_file(path):
            return Path(path)
        if "\\" in name:  # written on Windows
            return self.find(name.replace("\\", "/"))
        return Path(next((path + suffix for suffix in (".png", *SUFFIXES) if is_file(path + suffix)), path))

    def split_as_listed(self, source: Path, facts: dict, photos: list[PosedPhoto]) -> list[PosedPhoto]:
        """The photos, split as the file's lists say; unchanged if it has none. Without train_filenames, all photos that
        are not held out are trained on. Names may omit folder and suffix if they stay unambiguous."""
        lists = {split: facts[f"{split}_filenames"] for split in BLENDER_FILES if f"{split}_filenames" in facts}
        if not lists:
            return photos
        if not all(
            isinstance(names, list) and all(isinstance(name, str) for name in names) for names in lists.values()
        ):
            raise BadInput(f"{source} has a ..._filenames that is not a list of file names.", "Correct or remove it.")
        paths = {photo.path for photo in photos}
        rows, _ = rows_that_mean((path.as_posix() for path in paths), set().union(*lists.values()))
        meant = {row: Path(path) for path, row in rows.items()}
        listed = {split: {meant.get(name) or self.find(name) for name in names} for split, names in lists.items()}
        testing = "test" if listed.get("test") else "val"
        held_out = listed.get(testing, set())
        given = listed.get("train", paths - held_out)
        split = {path: "train" for path in given} | {path: "test" for path in held_out}
        self.notes += in_both("train_filenames", f"{testing}_filenames", [path.name for path in given & held_out])
        frameless, unlisted = split.keys() - paths, paths - split.keys()
        self.notes += name_them(
            f"listed in {source.name} without a usable frame", sorted(path.name for path in frameless)
        )
        self.notes += name_them(
            "listed neither for training nor for testing, not used", sorted(path.name for path in unlisted)
        )
        return [replace(photo, split=split[photo.path]) for photo in photos if photo.path in split]

    def points(self, facts: dict, photos: list[PosedPhoto]) -> Points | None:
        """The points of nerfstudio's COLMAP model or else of ply_file_path, or None. The latter are in the frame of the
        poses: applied_transform has been applied to both. (Older versions of nerfstudio did not apply it to points, so
        there is a check that the cameras see them.)"""
        points, notes = points_of_model(self.root, photos, self.image_ids)
        self.notes += notes
        if points is not None:
            return points
        name = facts.get("ply_file_path")
        if not isinstance(name, str):
            if name is not None:
                self.notes.append(Note(f"The ply_file_path {name!r} is no name of a file."))
            return None
        path = self.find(name)
        if not is_file(path):
            self.notes.append(Note(f"The points file {path} is missing."))
            return None
        positions, colours = read_points_file(path)
        good, notes = usable_points(positions)
        self.notes += notes
        if not good.any():
            self.notes.append(Note(f"The points file {path} has no usable points."))
            return None
        share = _share_in_view(positions[good], photos)
        if photos and share < IN_VIEW:
            what = f"Only {share:.0%} of the points of {path} lie before a camera"
            self.notes.append(Note(f"{what}: if they are in another frame than the poses, take out ply_file_path."))
        return Points(positions[good], colours[good], None)

    def posed(self, kind: str, source: Path, facts: dict, photos: list[PosedPhoto]) -> Posed:
        """All that was read, with the points. Photos are named by paths below their common folder,
        or by whole paths if there is none (drives of Windows)."""
        folder = self.root
        with suppress(ValueError):
            folder = Path(os.path.commonpath([photo.path.parent for photo in photos]))
            photos = [replace(photo, name=photo.path.relative_to(folder).as_posix()) for photo in photos]
        points = self.points(facts, photos)
        if points is None:
            for photo in photos:
                if not in_utf_8(photo.name):
                    self.faults.add("whose name is not in UTF-8, not used", photo.name)
            photos = [photo for photo in photos if in_utf_8(photo.name)]
        # Else what was taken out would come back.
        anew = SHRUNKEN if not any(is_file(photo.path) for photo in photos) else ()
        photos, found = with_files_found(photos, [self.root / name for name in ("images", ".", *anew)])
        missing_words = f"of {list_names(self.sources)} missing in {folder}"
        fix = f"Put the photos where its file_path says, or correct {source.name}."
        return Posed(kind, source, photos, points, missing_words, fix, self.faults.notes() + self.notes + found)


@dataclass(frozen=True)
class _Lens:
    """A frame's intrinsics as the file gives them; what is missing follows from the size of the photo."""

    model: str
    numbers: dict[str, float]

    @staticmethod
    def of(facts: dict, frame: dict) -> "_Lens":
        """The lens of a frame. facts: those at the top of the file, which the frame's own override; an angle in the
        frame also overrides a focal length there, and the other way round."""
        for own, others in ((ANGLES, LENGTHS), (LENGTHS, ANGLES)):
            if own & frame.keys():
                facts = {name: value for name, value in facts.items() if name not in others}
        facts = facts | frame
        model = str(facts.get("camera_model") or (FISHEYE if facts.get("is_fisheye") else PERSPECTIVE[0])).upper()
        if model not in (*PERSPECTIVE, FISHEYE):
            raise Fault(f"with a camera_model that is not supported ({model}; {PERSPECTIVE[0]} and {FISHEYE} are)")
        terms = ("w", "h", "cx", "cy", *LENGTHS, *ANGLES, *LENS_TERMS)
        try:
            if (listed := facts.get("distortion_params")) is not None:  # as nerfstudio reads them
                facts = facts | dict(zip(LENS_TERMS, listed, strict=True))
            numbers = {name: float(facts[name]) for name in terms if facts.get(name) is not None}
        except (TypeError, ValueError, OverflowError):
            raise Fault("with intrinsics that are not numbers") from None
        if not (LENGTHS | ANGLES) & numbers.keys():
            raise Fault("without fl_x or camera_angle_x")
        if not all(1 <= numbers.get(name, 1) <= LARGEST_SIDE_PX for name in ("w", "h")):
            raise Fault("with a w or h that no photo has")
        if model != FISHEYE and numbers.get("k4"):
            raise Fault(f"with a k4, which only {FISHEYE} lenses have")
        return _Lens(model, numbers)

    def camera(self, width: int, height: int) -> pycolmap.Camera:
        """COLMAP's camera of the same lens. Pixels are counted as there: the corner of the picture is (0, 0)."""
        numbers = self.numbers
        width, height = round(numbers.get("w", width)), round(numbers.get("h", height))
        x = numbers.get("fl_x", _focal_length(numbers.get("camera_angle_x"), width))
        y = numbers.get("fl_y", _focal_length(numbers.get("camera_angle_y"), height))
        focal = [y if x is None else x, x if y is None else y]  # only one is given if pixels are square
        centre = [numbers.get("cx", width / 2), numbers.get("cy", height / 2)]
        k1, k2, k3, k4, p1, p2 = (numbers.get(name, 0.0) for name in LENS_TERMS)
        if self.model == FISHEYE:  # has no p1 and p2, though files may list them
            model, terms = FISHEYE, [k1, k2, k3, k4]
        elif k3:
            model, terms = "FULL_OPENCV", [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]
        else:
            model, terms = "OPENCV", [k1, k2, p1, p2]
        return pycolmap.Camera(model=model, width=width, height=height, params=focal + centre + terms)


def _focal_length(angle: float | None, side: int) -> float | None:
    """The focal length (px) of a lens that sees `angle` radians across `side` px; NaN for an angle that no lens has."""
    if angle is None:
        return None
    return side / 2 / math.tan(angle / 2) if 0 < angle < math.pi else math.nan


def _pose(frame: dict) -> tuple[np.ndarray, np.ndarray]:
    """PosedPhoto.rotation and PosedPhoto.centre."""
    try:
        matrix = np.array(frame.get("transform_matrix"), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise Fault("without a transform_matrix of 4 x 4 numbers")
    return from_camera_to_world(matrix[:3] * [*TO_OPENCV, 1.0], "a transform_matrix")


def _share_in_view(points: np.ndarray, photos: list[PosedPhoto]) -> float:
    """The share of the points (P, 3) that some camera sees within 45 degrees of its viewing direction."""
    points = points[:: -(-len(points) // POINTS_ASKED)]
    seen = np.zeros(len(points), bool)
    for photo in photos:
        local = (points - photo.centre) @ photo.rotation.T
        seen |= local[:, 2] > np.linalg.norm(local[:, :2], axis=1)
    return float(seen.mean())


def _read_json(path: Path, may_be_empty: bool = False) -> dict:
    """The file's facts, with a list of "frames" that is not empty unless it may be."""
    fix = f"Write {path.name} again with the program that made it."
    try:
        facts = json.loads(path.read_bytes())
    except OSError as problem:
        raise BadInput(f"{path} cannot be read: {problem.strerror}.", fix) from None
    except RecursionError:
        raise BadInput(f"{path} is not valid JSON: it is nested too deeply.", fix) from None
    except ValueError as problem:  # of the text or of its encoding
        raise BadInput(f"{path} is not valid JSON: {problem}.", fix) from None
    if not isinstance(facts, dict) or not isinstance(facts.get("frames"), list):
        raise BadInput(f"{path} has no list of frames.", fix)
    if not facts["frames"] and not may_be_empty:
        raise BadInput(f"{path} has no frames.", fix)
    return facts
