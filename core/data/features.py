"""SIFT features of photos and their matches, by pycolmap on a CPU, in parts that tell of progress."""

from pathlib import Path

import pycolmap

from core.report import Report

LONG_SIDE_PX = 1600  # features are looked for in photos shrunk to this
FEATURES = 8192  # at most, a photo
LEAST_PHOTOS = 2
JPEG_QUALITY = 95  # of the copies that features are looked for in, and of undistorted photos
SEED = 0
USUAL_RATIO = 0.8  # Lowe's and COLMAP's
BATCHES = 24  # features and matches are computed in so many parts, to tell of progress and to notice Ctrl-C
PHOTOS, DATABASE = "photos", "database.db"  # in the folder of work


def extract(work: Path, names: list[str], report: Report, masks: Path | None = None) -> None:
    """SIFT features of the photos in work/photos into the database, each photo with a camera of its own.

    masks: a folder of pictures NAME.png that are black where there shall be none.
    """
    reading = pycolmap.ImageReaderOptions()
    if masks is not None:
        reading.mask_path = masks
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.max_image_size = LONG_SIDE_PX
    options.sift.max_num_features = FEATURES
    size = max(2, -(-len(names) // BATCHES))
    for start in range(0, len(names), size):
        batch = names[start : start + size]
        pycolmap.extract_features(
            work / DATABASE,
            work / PHOTOS,
            batch,
            pycolmap.CameraMode.PER_IMAGE,
            reading,
            extraction_options=options,
            device=pycolmap.Device.cpu,
        )
        report.progress("Features", start + len(batch), len(names))


def match(
    work: Path, pairs: list[tuple[str, str]], report: Report, verify: bool = True, ratio: float = USUAL_RATIO
) -> None:
    """Matches of the pairs of photos into the database.

    verify: keep those that one epipolar geometry explains, which is estimated; without it all that look alike stay.
    ratio: of the differences to the most and the second most similar feature; matches have a smaller one (Lowe 2004, 7.1).
    """
    options = pycolmap.FeatureMatchingOptions()
    options.use_gpu = False
    options.skip_geometric_verification = not verify
    options.sift.max_ratio = ratio
    lines = [f"{first} {second}" for first, second in pairs]
    size = max(8, -(-len(lines) // BATCHES))
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = work / "pairs.txt"
    for start in range(0, len(lines), size):
        batch = lines[start : start + size]
        (work / "pairs.txt").write_text("\n".join(batch) + "\n", encoding="utf-8")
        pycolmap.match_image_pairs(
            work / DATABASE, matching_options=options, pairing_options=pairing, device=pycolmap.Device.cpu
        )
        report.progress("Matches", start + len(batch), len(lines))
