"""SIFT features of photos and their matches, by pycolmap on a CPU, in parts between which progress is reported."""

import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

from core.data.collection import Photo
from core.data.photos.pixels import load_photo
from core.data.sfm.disk_space import check_growth
from core.errors import BadInput
from core.report import Report
from core.scene.camera import Camera
from core.system import memory
from core.system.cores import cores

LONG_SIDE_PX = 1600  # photos are shrunk to this before features are extracted
MOST_FEATURES = 8192  # of a photo, unless the caller asks for fewer
LEAST_PHOTOS = 2
JPEG_QUALITY = 95  # of the copies that features are extracted from, and of undistorted photos
SEED = 0  # given to every randomised estimate: pycolmap.set_random_seed would affect the calling thread only
USUAL_RATIO = 0.8  # Lowe's and COLMAP's
LEAST_INLIERS = 15  # COLMAP's, of the geometry of a pair
PART_S = 3.0  # features and matches are computed in parts that take this long, to report progress and to notice Ctrl-C
# Disk space, in the database and again in its journal, for a photo of MOST_FEATURES, and for a pair of such photos
# whose features all match.
PHOTO_BYTES, PAIR_BYTES = 3 << 20, 1 << 17
MOST_PHOTOS, MOST_PAIRS = 64, 512  # of a part, however fast: those that are in the database already take no time
PHOTOS, MASKS, DATABASE = "photos", "masks", "database.db"  # in the work folder
# Memory for a thread that finds or matches MOST_FEATURES in square photos of LONG_SIDE_PX, in others less; allocated,
# as `memory.limit` counts: a fifth of it is never touched.
THREAD_BYTES = 900 << 20
HALF = 128  # of 255: features are extracted where less of a pixel than this is empty space


def write_pictures(posed: list[tuple[Photo, Camera]], work: Path, report: Report) -> dict[str, tuple[Photo, Camera]]:
    """Write the pictures that `extract` reads; returns, by a picture's name, its photo and the camera at its size.

    Their names are numbers, because COLMAP splits its list of pairs at spaces. Photos that cannot be decoded are left
    out.
    """
    for folder in (PHOTOS, MASKS):
        (work / folder).mkdir(exist_ok=True)
    cameras = {}
    for number, (photo, camera) in enumerate(posed, 1):
        name = f"{number:06d}.jpg"
        with suppress(BadInput):
            cameras[name] = photo, _write_picture(photo, camera, work, name)
        report.progress("Photos", number, len(posed))
    return cameras


def _write_picture(photo: Photo, camera: Camera, work: Path, name: str) -> Camera:
    """Write a photo, undistorted and shrunk to LONG_SIDE_PX, and its mask; returns its camera at that size.
    BadInput if it cannot be decoded."""
    camera = camera.within(LONG_SIDE_PX)
    loaded = load_photo(photo, camera.width, camera.height, transparent_is_empty=True)
    shown = np.ones(loaded.pixels.shape[:2], bool) if loaded.valid is None else loaded.valid
    if loaded.empty is not None:
        shown &= loaded.empty < HALF
    Image.fromarray(loaded.pixels).save(work / PHOTOS / name, quality=JPEG_QUALITY)
    Image.fromarray(shown * np.uint8(255)).save(work / MASKS / f"{name}.png")  # COLMAP reads no photo that lacks one
    return camera


def extract(work: Path, names: list[str], report: Report, masks: Path | None = None, most: int = MOST_FEATURES) -> None:
    """SIFT features of the photos in work/photos into the database, each photo with a camera of its own.

    masks: a folder of pictures NAME.png, black where no feature is wanted. most: features a photo.
    """
    reading = pycolmap.ImageReaderOptions()
    if masks is not None:
        reading.mask_path = masks
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.max_image_size = LONG_SIDE_PX
    options.sift.max_num_features = most
    options.num_threads = threads_within_room()
    for done, part in in_parts(names, 2, MOST_PHOTOS):
        check_growth(work / DATABASE, len(part) * PHOTO_BYTES)
        _number(work, part)
        pycolmap.extract_features(
            work / DATABASE,
            work / PHOTOS,
            part,
            pycolmap.CameraMode.PER_IMAGE,
            reading,
            extraction_options=options,
            device=pycolmap.Device.cpu,
        )
        report.progress("Features", done, len(names))


def _number(work: Path, names: list[str]) -> None:
    """Add the photos to the database in their order.
    Otherwise they get their ids as threads finish with them, and mapping depends on the ids."""
    with pycolmap.Database.open(work / DATABASE):
        pass  # creates it
    pycolmap.import_images(work / DATABASE, work / PHOTOS, pycolmap.CameraMode.PER_IMAGE, image_names=names)


def images_in(database: pycolmap.Database) -> dict[str, pycolmap.Image]:
    """What the database says of its images, by name."""
    return {image.name: image for image in database.read_all_images()}


def match(
    work: Path, pairs: list[tuple[str, str]], report: Report, verify: bool = True, ratio: float = USUAL_RATIO
) -> None:
    """Match the pairs of photos; the matches go into the database.

    verify: estimate the geometry of each pair, and keep only the matches that fit it.
    ratio: a match must be nearer than this times the distance of the second most similar feature (Lowe 2004, 7.1).
    """
    options = pycolmap.FeatureMatchingOptions()
    options.use_gpu = False
    options.num_threads = threads_within_room()
    options.skip_geometric_verification = not verify
    options.sift.max_ratio = ratio
    verification = pycolmap.TwoViewGeometryOptions(min_num_inliers=LEAST_INLIERS)
    verification.ransac.random_seed = SEED  # else each thread draws on
    lines = [f"{first} {second}" for first, second in pairs]
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = work / "pairs.txt"
    for done, part in in_parts(lines, 8, MOST_PAIRS):
        check_growth(work / DATABASE, len(part) * PAIR_BYTES)
        (work / "pairs.txt").write_text("\n".join(part) + "\n", encoding="utf-8")
        pycolmap.match_image_pairs(
            work / DATABASE,
            matching_options=options,
            pairing_options=pairing,
            verification_options=verification,
            device=pycolmap.Device.cpu,
        )
        report.progress("Matches", done, len(lines))


def threads_within_room() -> int:
    """One thread a core, or as many as memory has room for: beyond it, pycolmap or the system would end the program."""
    return min(cores(), memory.fitting(THREAD_BYTES))


def in_parts(items: list[str], least: int, most: int) -> Iterator[tuple[int, list[str]]]:
    """The items in parts of `least` to `most`, sized to take PART_S each,
    and for each part the number of items up to its end."""
    done, size = 0, least
    while done < len(items):
        part, since = items[done : done + size], time.monotonic()
        done += len(part)
        yield done, part
        size = max(least, min(most, 2 * size, int(size * PART_S / max(time.monotonic() - since, 1e-3))))
