"""Checks of a scene before training: its cameras, photos, points and world coordinates."""

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from core.config import Settings
from core.data import find_kind, find_photos, load_collection
from core.data.collection import CHECK_POSES, LEAST_SHOWN, Collection, Photo, astray, looks_away
from core.data.formats.colmap import MODEL_FOLDERS
from core.data.load import model_elsewhere, not_searched, passed_over, scene_around
from core.data.photos.file import named_with_fault
from core.data.photos.folder import list_gone, list_photos, list_unreadable
from core.data.photos.pixels import load_photo
from core.data.placing import USUAL_FOCAL_LENGTHS, focal_length_of, is_usual
from core.data.sfm.features import LEAST_PHOTOS
from core.data.sfm.likely_pairs import longest_s, most_pairs
from core.data.sfm.originals import placed_of, shortfall
from core.data.sfm.usable import StoredTwice, usable_photos
from core.data.transparency import transparent_may_be_empty
from core.doctor import views
from core.doctor.finding import Finding
from core.errors import BadInput, command
from core.report import Report
from core.words import Note, counted, list_names

FEW_POINTS = 20  # a photo that sees fewer has an uncertain pose; SfM itself demands 15 to 30
POINTS_WANTED = 500  # to start Gaussians from
ODD_DISTANCE = 10.0  # from the scene's centre, times the median camera's
ASPECT = 0.05  # by which fx and fy may differ; no real camera exceeds it
OFF_CENTRE = 0.15  # of a side: the principal point of a photo that was cropped
FLAT = 3.0  # standard deviation in 8-bit steps; a photo below it shows nothing
SMALL_PX = 160  # photos are decoded to about this width
REMOVE = "Remove them from the model unless they are what they seem."
SQUARE = "Unless they are, run SfM with one focal length."
CENTRED = "Unless they are, run SfM with the middle fixed."


def examine_scene(root: Path, report: Report) -> list[Finding]:
    """Findings about a scene of any kind that wegs reads, or about plain photos. BadInput if the folder is neither."""
    if find_kind(root) == "photos":
        return _plain_photos(root, report)
    collection = load_collection(root)
    train, test = (len(collection.split(name)) for name in ("train", "test"))
    return [
        Finding(
            "scene",
            f"{collection.kind}, {train:,} training and {counted(test, 'test photo')}",
            "what `wegs train` would read",
        ),
        *(_reading(note) for note in collection.notes if not note.of_cameras),
        *placed_photos(root),
        *_cameras(collection),
        *_points(collection),
        _world(collection),
        *_photos(collection, report),
    ]


def _reading(note: Note) -> Finding:
    """A note from reading the scene as a finding, with advice unless it is harmless."""
    advice = "" if note.harmless else "Correct it unless it is meant."
    return Finding("reading", note.text.rstrip("."), "said while the scene was read", advice)


def placed_photos(scene: Path) -> list[Finding]:
    """How many photos structure from motion placed, in a scene that wegs made of plain photos."""
    if (counts := placed_of(scene)) is None:
        return []
    total, placed, _ = counts
    meaning = "by structure from motion" if placed == total else "by structure from motion; the others are left out"
    advice = "Expect a poor scene. Add photos from in between." if shortfall(scene) else ""
    return [Finding("photos placed", f"{placed} of {total}", meaning, advice)]


def odd_focal_lengths(photos: Sequence[Photo]) -> Finding:
    """Which photos have a focal length that no lens has."""
    low, high = USUAL_FOCAL_LENGTHS
    odd = [f"{photo.name}: {focal_length_of(photo.camera):.3g}" for photo in photos if not is_usual(photo.camera)]
    advice = REMOVE
    if 2 * len(odd) > len(photos):
        advice = (
            "Unless they are what they seem, expect a poor scene: "
            "add photos from in between and find the cameras again."
        )
    return _named("odd focal lengths", odd, len(photos), f"outside {low:.2g} to {high:.2g}: no lens has them", advice)


def _named(name: str, photos: list[str], total: int, meaning: str, advice: str) -> Finding:
    """A finding that counts and names photos."""
    if not photos:
        return Finding(name, "none", "")
    return Finding(name, f"{len(photos)} of {total} ({list_names(photos)})", meaning, advice)


def _cameras(collection: Collection) -> list[Finding]:
    photos, total = collection.photos, len(collection.photos)
    cameras = {photo.name: photo.camera for photo in photos}
    squeezed = [name for name, c in cameras.items() if abs(np.log(c.fx / c.fy)) > ASPECT]
    crooked = [
        name for name, c in cameras.items() if max(abs(c.cx / c.width - 0.5), abs(c.cy / c.height - 0.5)) > OFF_CENTRE
    ]
    far = [photo.name for photo, is_far in zip(photos, astray(photos, ODD_DISTANCE), strict=True) if is_far]
    away = [photo.name for photo in photos if len(collection.points) and looks_away(photo, collection.points)]
    looking = (
        f"see less than {LEAST_SHOWN:.0%} of the points said to be theirs, or, "
        "where nothing says which these are, no point at all"
    )
    lengths = np.array([focal_length_of(camera) for camera in cameras.values()])
    figure = f"{lengths.min():.3g} to {lengths.max():.3g}, median {np.median(lengths):.3g}"
    return [
        Finding("focal lengths", figure, "in lengths of the longer side"),
        odd_focal_lengths(photos),
        _named("unequal focal lengths", squeezed, total, f"fx and fy over {ASPECT:.0%} apart: squeezed photos", SQUARE),
        _named("principal points", crooked, total, f"over {OFF_CENTRE:.0%} of a side off the middle: crops", CENTRED),
        _named("cameras astray", far, total, f"over {ODD_DISTANCE:.0f} times as far off as the median one", REMOVE),
        _named("cameras that look away", away, total, looking, CHECK_POSES if 2 * len(away) > total else REMOVE),
    ]


def _points(collection: Collection) -> list[Finding]:
    photos, count = collection.photos, len(collection.points)
    if not count:  # a note says so as well; training triangulates them
        training = len(collection.split("train"))
        needed = f"Add photos: at least {LEAST_PHOTOS} to train on are needed to triangulate points."
        fix = needed if training < LEAST_PHOTOS else ""
        return [Finding("points", "none", f"training triangulates them from {counted(training, 'photo')}", fix)]
    seen = {photo.name: len(photo.points) for photo in photos}
    few = [f"{name}: {points}" for name, points in seen.items() if points < FEW_POINTS]
    farthest = np.linalg.norm(collection.points, axis=1).max()
    if any(seen.values()):
        each = f", {np.median(list(seen.values())):.0f} a photo (median)"
        more = "Add photos, or run SfM with more features."
    else:  # unknown which photo sees which
        each, more = "", "Give more of them, or run SfM with more features."
    figure = f"{count:,}{each}, the farthest {farthest:.3g} radii off"
    found = Finding("points", figure, "Gaussians start from them", more if count < POINTS_WANTED else "")
    if collection.kind != "colmap" or collection.points_from or not any(seen.values()):
        return [found]  # the poses were not estimated from these points
    return [
        found,
        _named(
            "photos with few points",
            few,
            len(photos),
            f"fewer than {FEW_POINTS} hold their pose",
            "Look at their renders.",
        ),
    ]


def _world(collection: Collection) -> Finding:
    frame = collection.frame
    distance = float(np.linalg.norm(frame.centre))
    cameras = [photo.camera for photo in collection.photos]
    plain = views.float32_error(frame, collection.points, cameras)
    cost = f"float32 without recentring would cost {plain.figure}; training recentres in float64"
    moved = ", and files are written around the scene" if frame.file_offset.any() else ""
    figure = f"a radius of {frame.radius:.4g} units, {distance:.4g} units from the origin"
    return Finding("world", figure, f"{cost}{moved}")


def _photos(collection: Collection, report: Report) -> list[Finding]:
    unusable, flat, may_be_empty = {}, [], transparent_may_be_empty(collection, Settings())
    photos = collection.split("train") + collection.split("test")
    for done, photo in enumerate(photos, 1):
        small = photo.camera.shrunk(SMALL_PX / photo.camera.width)
        try:
            loaded = load_photo(photo, small.width, small.height, transparent_is_empty=may_be_empty)
        except BadInput as problem:
            unusable[named_with_fault(photo.name, photo.path, problem)] = problem.fix
        else:
            if is_flat(loaded.pixels) and loaded.empty is None:
                flat.append(f"{photo.name}: {loaded.pixels.mean():.0f} of 255")
        report.progress("Photos", done, len(photos), photo.name)
    return _photo_findings(unusable, flat, len(photos))


def is_flat(pixels: np.ndarray) -> bool:
    """Whether all values of a picture (H, W, 3) are about equal: it is black, white or of one grey."""
    # NumPy's std takes 0.8 s and 280 MB for a photo of 12 MP, this a hundredth of a second and no memory.
    means, deviations = cv2.meanStdDev(pixels)
    return math.sqrt(np.square(deviations).mean() + means.var()) < FLAT


def _photo_findings(unusable: dict[str, str], flat: list[str], total: int) -> list[Finding]:
    """unusable: photos with their faults, and what to do about each."""
    fix = " ".join(dict.fromkeys(unusable[photo] for photo in sorted(unusable)))
    return [
        _named("unusable photos", sorted(unusable), total, "cannot be used; training leaves them out", fix),
        _named(
            "photos of one colour",
            sorted(flat),
            total,
            "black, white or covered: nothing to learn from",
            "Remove them.",
        ),
    ]


def _plain_photos(root: Path, report: Report) -> list[Finding]:
    """Findings about photos without cameras: whether they can be read, and what comes next."""
    folder = find_photos(root)
    paths, flat, again, sizes = list_photos(folder), [], [], []
    gone = {
        f"{path.name} (is a link to a file that is gone)": "Connect its disk, or copy the photo."
        for path in list_gone(folder)
    }
    unusable = dict(gone)
    for path, photo in usable_photos(paths, report):
        if isinstance(photo, StoredTwice):
            again.append(photo.what.rstrip("."))
        elif isinstance(photo, BadInput):
            unusable[named_with_fault(path.name, path, photo)] = photo.fix
        else:
            sizes.append(photo.header.width * photo.header.height / 1e6)
            if is_flat(photo.pixels):
                flat.append(f"{path.name}: {photo.pixels.mean():.0f} of 255")
    figure = counted(len(paths), "photo")
    if sizes:
        least, most = (f"{size:.2g}" if size < 10 else f"{size:.0f}" for size in (min(sizes), max(sizes)))
        figure += f" of {least} MP" if least == most else f" of {least} to {most} MP"
    others = [path.name for path in list_unreadable(folder)]
    return [
        Finding("scene", figure, *_cameras_to_come(root, folder, len(sizes))),
        *_photos_elsewhere(root, folder),
        *_photo_findings(unusable, flat, len(paths) + len(gone)),
        _named(
            "pictures stored twice", sorted(again), len(paths), "left out; the fullest file of each picture is used", ""
        ),
        _named(
            "photos in other formats",
            others,
            len(paths) + len(others),
            "cannot be read, left out",
            "Convert them to JPEG.",
        ),
    ]


def _cameras_to_come(root: Path, folder: Path, usable: int) -> tuple[str, str]:
    """How the photos in `folder`, so many of them usable, get cameras, and what to do first, if anything."""
    if around := scene_around(folder):
        return (
            f"photos within the {around[1]} scene {around[0]}",
            "Give that folder to use its cameras, if it names these photos.",
        )
    if usable < LEAST_PHOTOS:
        needed = f"at least {LEAST_PHOTOS} different ones that can be read are needed to find cameras"
        return "photos without cameras", f"Add photos of the same place: {needed}."
    work = f"{counted(most_pairs(usable), 'pair')} to match, up to {_in_words(longest_s(usable))}"
    return f"photos without cameras; next, `{command('wegs', 'train', root)}` finds them ({work}) and trains", ""


def _in_words(seconds: float) -> str:
    """The time in words, rounded up to whole minutes or, beyond two hours, to whole hours."""
    what, length = ("hour", 3600) if seconds > 2 * 3600 else ("minute", 60)
    return counted(math.ceil(seconds / length), what)


def _photos_elsewhere(root: Path, folder: Path) -> list[Finding]:
    """Findings about photos and cameras in and below `root` that are not used,
    because only the photos in `folder` are."""
    used = len(list_photos(folder))
    findings = [
        Finding(
            "photos elsewhere",
            f"{count} in {other}, beside the {used} in {folder}",
            "only one folder is used",
            "Put all photos into one.",
        )
        for other, count in passed_over(root, folder).items()
    ]
    if model := model_elsewhere(root):
        findings.append(
            Finding(
                "cameras elsewhere",
                f"{model} holds a COLMAP model",
                "not used",
                f"Move it to {root / MODEL_FOLDERS[0]}.",
            )
        )
    if below := not_searched(root):
        figure = f"{sum(below.values())} in {list_names(list(map(str, below)))}, beside the {used} in {folder}"
        # Fewer may be masks, or thumbnails.
        advice = "Give that folder, or put all photos into one." if max(below.values()) > used else ""
        findings.append(Finding("photos elsewhere", figure, "subfolders are not searched", advice))
    return findings
