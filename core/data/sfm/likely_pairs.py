"""Which pairs of photos to match: all if they are few, else those whose largest features look alike.

Matching all features of a pair takes a fifteenth of a second on two cores, this search a millisecond. With 1,000 photos
the search takes 8 minutes and matching the likely pairs 35; matching all pairs would take ten hours.
"""

from pathlib import Path

import numpy as np
import pycolmap
import torch

from core.data.sfm.features import DATABASE, images_in
from core.report import Report
from core.system.threads import in_parallel

# Statue of Liberty, 87 photos, of the ten that each shares most points with: 512 features find 74, 87, 91 % among 10,
# 20, 30 partners, 256 features 66, 81, 88 %, VLAD of 256 words 53, 72, 81 %.
LARGEST_FEATURES = 512  # of a photo
PARTNERS = 30  # of a photo
MATCH_S = 0.07  # to match two photos of 1600 px or more of the same thing, on two cores; two thirds of that for others
COUNT_S = 1e-3  # to count how many of the largest features of two photos look alike
BLOCK = 16  # photos that a thread compares with another one at a time
RATIO = 0.85  # test of Lowe (2004, section 7.1): the angle to the nearest feature over that to the second nearest


def likely_pairs(work: Path, names: list[str], report: Report) -> list[tuple[str, str]]:
    """The pairs of photos in the database to match:
    all, or each photo's PARTNERS likeliest, so that matching (not this search) is linear in the number of photos.

    The more of their LARGEST_FEATURES largest features match, the likelier two photos overlap (Wu 2013, Towards
    linear-time incremental structure from motion, section 3): there are few of them, and large features are seen from
    near and far.
    """
    total = all_pairs(len(names))
    if total == most_pairs(len(names)):
        return [(first, second) for index, first in enumerate(names) for second in names[:index]]
    largest = largest_features(work, names)
    found = np.zeros((len(names), len(names)), np.int32)
    for index, features in enumerate(largest):
        found[index, :index] = found[:index, index] = _counts_alike(features, largest[:index])
        report.progress("Likely pairs", (index + 1) * index // 2, total)
    np.fill_diagonal(found, -1)
    chosen = np.argsort(-found, axis=1, kind="stable")[:, :PARTNERS]
    pairs = {(max(index, int(other)), min(index, int(other))) for index, row in enumerate(chosen) for other in row}
    report.say(
        f"{len(names)} photos make {total:,} pairs; "
        f"the {len(pairs):,} whose largest features look most alike are matched."
    )
    return [(names[first], names[second]) for first, second in sorted(pairs)]


def all_pairs(photos: int) -> int:
    """How many pairs this many photos make."""
    return photos * (photos - 1) // 2


def most_pairs(photos: int) -> int:
    """The most pairs that are matched for this many photos."""
    return min(all_pairs(photos), photos * PARTNERS)


def longest_s(photos: int) -> float:
    """The most seconds that it takes to find the pairs to match of this many photos, and to match them."""
    total, matched = all_pairs(photos), most_pairs(photos)
    return matched * MATCH_S + (total * COUNT_S if matched < total else 0.0)


def _counts_alike(features: np.ndarray, others: list[np.ndarray]) -> np.ndarray:
    """How many of these features are alike in each of the other photos (n,)."""
    counts = np.zeros(len(others), np.int32)

    def count(begin: int, end: int) -> None:
        counts[begin:end] = [count_alike(features, other) for other in others[begin:end]]

    in_parallel(count, len(others), BLOCK)
    return counts


def count_alike(first: np.ndarray, second: np.ndarray) -> int:
    """How many of these features, (n, 128) of length 1, are each other's nearest and pass the RATIO test."""
    if min(len(first), len(second)) < 2:
        return 0
    # By torch, which can be held to one thread: the threads of NumPy's BLAS spin while they wait for each other.
    similarity = (torch.from_numpy(first) @ torch.from_numpy(second).T).numpy()
    rows = np.arange(len(first))
    nearest = similarity.argmax(axis=1)
    best = similarity[rows, nearest]
    similarity[rows, nearest] = -1
    angles, others = (np.arccos(np.clip(values, -1, 1)) for values in (best, similarity.max(axis=1)))
    similarity[rows, nearest] = best
    clear = np.flatnonzero(angles < RATIO * others)  # few: only their columns are searched
    return int((similarity[:, nearest[clear]].argmax(axis=0) == clear).sum())


def largest_features(work: Path, names: list[str]) -> list[np.ndarray]:
    features = []
    with pycolmap.Database.open(work / DATABASE) as database:
        images = images_in(database)
        for name in names:
            number = images[name].image_id
            # 2 x 2, its columns as long as the feature is large.
            shapes = database.read_keypoints(number).reshape(-1, 6)[:, 2:]
            order = np.argsort(-np.hypot(shapes[:, 0], shapes[:, 2]), kind="stable")[:LARGEST_FEATURES]
            descriptors = database.read_descriptors(number).data[order].astype(np.float32)
            features.append(descriptors / np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-6))
    return features
