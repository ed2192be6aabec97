"""Structure from motion: a folder of plain photos becomes a COLMAP scene, with pycolmap, on a CPU."""

import os
import shutil
from collections.abc import Container, Iterable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

import core
from core.data.formats.model_file import quiet
from core.data.photos.distortion import lens_of, pinhole, undistort
from core.data.photos.file import upright_exif
from core.data.photos.folder import list_gone, list_photos, list_unreadable
from core.data.photos.pixels import off_white, read_pixels
from core.data.sfm.disk_space import check_room, write_model
from core.data.sfm.features import JPEG_QUALITY, LEAST_PHOTOS, PHOTOS, extract, match
from core.data.sfm.guided import guide
from core.data.sfm.kept_matches import keep_if_of, work_kept_if_stopped
from core.data.sfm.likely_pairs import likely_pairs
from core.data.sfm.mapping import map_photos
from core.data.sfm.originals import LENSES, MADE_OF, NAMES, files_of
from core.data.sfm.upright import turn_upright
from core.data.sfm.usable import StoredTwice, UsablePhoto, usable_photos
from core.data.split import copy_lists
from core.errors import BadInput
from core.report import Report
from core.scene.camera import Camera
from core.scene.lens import Lens
from core.system.atomic import NAME_PART, replacing_folder, write_json
from core.system.outputs import check_folder, files_in
from core.words import counted, list_names, name_them

ALPHA = "alpha"  # folder, in the work folder, of what is known of transparency
JPEG_SUFFIXES = (".jpg", ".jpeg")
LONGEST_NAME = 255  # bytes, of the usual disks; of a PNG whose name is nearly as long, that of its JPEG is longer
JPEG_PIXEL_BYTES, PNG_PIXEL_BYTES = 1.5, 4  # of an undistorted photo, at most
FEATURES_TO_MAP = 4096  # at most, a photo: as good as 6,000 and 8,192 (core/TRIED.md)


def reconstruct(photos: Path, output: Path, report: Report, lists: Iterable[Path] = ()) -> Path:
    """Find the cameras of the photos in the folder `photos`;
    `output` becomes a COLMAP scene of them, whole or not at all.

    The scene holds images/ (undistorted, upright), sparse/0 (pinhole cameras, points) and the files of
    core.data.sfm.originals. Every photo gets a camera of its own, as tourists' photos need. If the photos fall apart
    into several models, the one with the most photos is kept. It stands upright, as far as photos tell
    (core.data.sfm.upright). Unreadable photos and those without a camera are left out and named. What a stopped run
    found is used again (core.data.sfm.kept_matches). lists: folders whose split lists the scene gets as well. Up to
    core.data.sfm.mapping.REPEATABLE photos two runs nearly always agree bit for bit; beyond, COLMAP maps on several
    threads, and they differ slightly.

    Raises BadInput for a folder with fewer than two readable photos, for an output that cannot be written or is
    anything but a new or empty folder, and where no model is found; DiskFull.
    """
    if output.resolve() == Path.cwd():
        raise BadInput("The scene cannot be the folder you are in.", "Name a folder to be made: -o scene")
    if output.exists() and (not output.is_dir() or files_in(output)):
        raise BadInput(f"{output} exists and is not an empty folder.", "Choose another -o.")
    check_folder(output)
    paths = list_photos(photos)
    unreadable, gone = ([path.name for path in found] for found in (list_unreadable(photos), list_gone(photos)))
    left_out = name_them("in formats that cannot be read, left out; convert them to JPEG", unreadable)
    for note in [*left_out, *name_them("whose file is gone, left out", gone)]:
        report.warn(note.text)
    made_of = files_of(photos)
    with replacing_folder(output) as new, work_kept_if_stopped(output, report) as work, quiet():
        (new / "scene").mkdir()
        copy_lists(lists, new / "scene")  # first: an error in reading one comes before the minutes of work
        copies, originals = copy_upright(paths, work, report)
        names = list(copies)
        if len(names) < LEAST_PHOTOS:
            raise BadInput(
                f"{photos} holds {counted(len(names), 'photo')} that can be used; at least {LEAST_PHOTOS} are needed.",
                "Add photos of the same place.",
            )
        versions = {"wegs": core.__version__, "pycolmap": pycolmap.__version__}
        keep_if_of({"photos": made_of, "copies": copies, "features": FEATURES_TO_MAP, **versions}, work, report)
        extract(work, names, report, most=FEATURES_TO_MAP)
        pairs = likely_pairs(work, names, report)
        match(work, pairs, report)
        guide(work, pairs, report)  # core/TRIED.md has the figures
        model = map_photos(work, names, report)
        turn_upright(model)
        placed = {copies[image.name] for image in model.images.values() if image.has_pose}
        write_scene(work, model, copies, new / "scene")
        write_json(new / "scene" / MADE_OF, made_of)
        write_json(new / "scene" / NAMES, {str(path.resolve()): name for path, name in originals.items()})
    lost = [path.name for path, name in originals.items() if name not in placed]
    for note in name_them("that got no place, left out", lost):
        report.warn(note.text)
    report.say(f"{output}: {counted(len(placed), 'photo')} with cameras, {counted(model.num_points3D(), 'point')}")
    return output


def copy_upright(paths: list[Path], work: Path, report: Report) -> tuple[dict[str, str], dict[Path, str]]:
    """Copy the readable photos into work/PHOTOS as COLMAP needs them;
    returns their names in the scene, by the name of the copy and by file.

    COLMAP ignores EXIF rotation and colour profiles, so photos with either are written upright and in sRGB. Other
    formats are converted to JPEG; the alpha of photos that are not opaque goes into work/ALPHA, as a PNG under the
    photo's name in the scene. Copies are named by numbers, because COLMAP splits its list of pairs at spaces.
    """
    for folder in (PHOTOS, ALPHA):
        (work / folder).mkdir()
    numbers = {path: number for number, path in enumerate(paths, 1)}
    copies: dict[str, str] = {}
    originals: dict[Path, str] = {}
    twice, turned = [], 0
    for path, photo in usable_photos(paths, report):
        if isinstance(photo, StoredTwice):
            twice.append(photo.what.rstrip("."))
            continue
        if isinstance(photo, BadInput):
            report.warn(f"Left out: {photo.what}")
            continue
        copy, name = f"{numbers[path]:06d}.jpg", _name_in_scene(path, photo, f"{numbers[path]}-", originals.values())
        copies[copy] = originals[path] = name
        if photo.header.is_jpeg and photo.header.orientation == 1 and not photo.header.profile:
            shutil.copyfile(path, work / PHOTOS / copy)
        else:
            write_jpeg(photo, work / PHOTOS / copy)
        turned += photo.header.orientation != 1
        if photo.alpha is not None:
            Image.fromarray(photo.alpha).save(work / ALPHA / name)
    if twice:
        report.say(f"{counted(len(twice), 'picture')} stored twice, left out: {list_names(sorted(twice))}")
    if turned:
        report.say(f"{counted(turned, 'photo')} turned upright, as EXIF says.")
    return dict(sorted(copies.items())), {path: originals[path] for path in paths if path in originals}


def _name_in_scene(path: Path, photo: UsablePhoto, prefix: str, taken: Container[str]) -> str:
    """The photo's own name, in UTF-8 as COLMAP demands, with a suffix of the format in which it will be written.

    If that is `taken`, or too long for a disk, the prefix and the end of it; again if need be.
    """
    name = os.fsencode(path.name).decode("utf-8", "replace")
    suffixes = JPEG_SUFFIXES if photo.alpha is None else (".png",)
    if path.suffix.lower() not in suffixes:
        name += suffixes[0]
    while name in taken or len(name.encode()) > LONGEST_NAME:
        name = prefix + name[-NAME_PART:]
    return name


def write_jpeg(photo: UsablePhoto, path: Path) -> None:
    """The photo as displayed, with its EXIF block, whose focal length COLMAP starts from."""
    Image.fromarray(photo.pixels).save(path, quality=JPEG_QUALITY, exif=upright_exif(photo.header.exif))


def write_scene(work: Path, model: pycolmap.Reconstruction, copies: dict[str, str], scene: Path) -> None:
    """Undistort the model's photos, under their own names, into scene/images, and the model into scene/sparse/0."""
    named, chosen, undistorted = (work / name for name in ("named", "chosen", "undistorted"))
    named.mkdir()
    for image in model.images.values():
        os.replace(work / PHOTOS / image.name, named / copies[image.name])
        image.name = copies[image.name]
    chosen.mkdir()
    write_model(model, chosen)
    lenses = {image.name: lens_of(model.cameras[image.camera_id]) for image in model.images.values() if image.has_pose}
    check_room(work, sum(_most_bytes(name, lens) for name, lens in lenses.items()))
    pycolmap.undistort_images(undistorted, chosen, named, jpeg_quality=JPEG_QUALITY)
    (scene / "sparse").mkdir(parents=True)
    if alphas := {path.name: path for path in (work / ALPHA).glob("*") if path.name in lenses}:
        for image in pycolmap.Reconstruction(undistorted / "sparse").images.values():
            if image.name in alphas:
                give_alpha(undistorted / "images" / image.name, image.camera, alphas[image.name], lenses[image.name])
    os.replace(undistorted / "images", scene / "images")
    os.replace(undistorted / "sparse", scene / "sparse" / "0")
    write_json(scene / LENSES, {name: asdict(lens) for name, lens in lenses.items()})


def _most_bytes(name: str, lens: Lens) -> int:
    """The most bytes that the undistorted photo of that name can take."""
    pixel_bytes = PNG_PIXEL_BYTES if name.lower().endswith(".png") else JPEG_PIXEL_BYTES
    return int(pixel_bytes * lens.width * lens.height)


def give_alpha(picture: Path, camera: pycolmap.Camera, alpha: Path, lens: Lens) -> None:
    """Make the undistorted `picture`, COLMAP's PNG of the photo over white, transparent where the photo was,
    or where its lens saw nothing.

    camera: the pinhole of the undistorted picture. lens: the photo's own.
    """
    seen_from = Camera(
        np.eye(3), np.zeros(3), *pinhole(camera, camera.width, camera.height), camera.width, camera.height
    )
    found, seen = undistort(read_pixels(alpha)[..., :1], lens, seen_from)
    opacity = found[..., 0] * seen
    Image.fromarray(np.dstack([off_white(read_pixels(picture), opacity), opacity])).save(picture)
