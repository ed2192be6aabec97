"""Which photos are matched: of few, all with all; of many, those that share their largest features."""

import numpy as np
import pycolmap
import pytest

from core.data.sfm import likely_pairs as module
from core.data.sfm.features import DATABASE, extract
from core.data.sfm.likely_pairs import count_alike, likely_pairs, longest_s, most_pairs
from core.report import Report
from tests.data.room_corner import save_corner
from tests.heard import Heard

NAMES = [f"{number}.jpg" for number in range(9)]


def features(count, seed):
    values = np.random.default_rng(seed).normal(size=(count, 128)).astype(np.float32)
    return values / np.linalg.norm(values, axis=1, keepdims=True)


def test_few_photos_are_matched_all_with_all(tmp_path):
    pairs = likely_pairs(tmp_path, NAMES, Report())  # no database is asked
    assert len(pairs) == len(set(pairs)) == 36 and all(first > second for first, second in pairs)


def test_of_many_photos_those_are_matched_that_share_features(tmp_path, monkeypatch):
    """The photos stand in a line: each shares half of its features with either neighbour,
    and the last shows nothing."""
    strip = features(500, 0)
    shown = [strip[50 * number : 50 * number + 100] for number in range(8)] + [strip[:0]]
    monkeypatch.setattr(module, "largest_features", lambda work, names: shown)
    monkeypatch.setattr(module, "PARTNERS", 2)
    heard = Heard()
    pairs = likely_pairs(tmp_path, NAMES, heard)
    neighbours = {(NAMES[number + 1], NAMES[number]) for number in range(7)}
    assert neighbours <= set(pairs) and len(pairs) <= 2 * len(NAMES)
    # None with itself, though some share features with fewer than two.
    assert all(first > second for first, second in pairs)
    assert heard.lines == [
        f"9 photos make 36 pairs; the {len(pairs)} whose largest features look most alike are matched."
    ]
    assert heard.steps[-1] == (36, 36)


@pytest.mark.parametrize(
    ("photos", "pairs", "seconds"),
    [(2, 1, 0.07), (61, 1830, 128.1), (62, 1860, 130.2 + 1.891), (1000, 30_000, 2_100 + 499.5)],
)
def test_the_time_that_matching_takes_counts_the_search_for_likely_pairs(photos, pairs, seconds):
    assert most_pairs(photos) == pairs and longest_s(photos) == pytest.approx(seconds)


def test_the_search_finds_the_same_on_any_number_of_threads(tmp_path, monkeypatch, on_threads):
    strip = features(400, 3)
    shown = [strip[10 * number : 10 * number + 60] for number in range(30)]
    monkeypatch.setattr(module, "largest_features", lambda work, names: shown)
    monkeypatch.setattr(module, "PARTNERS", 4)
    monkeypatch.setattr(module, "BLOCK", 4)
    names = [f"{number}.jpg" for number in range(30)]
    found = on_threads((1, 2, 3), lambda: likely_pairs(tmp_path, names, Report()))
    assert len(found[0]) < 435 and found[0] == found[1] == found[2]


def test_only_features_that_are_each_others_nearest_count():
    some, others = features(40, 1), features(60, 2)
    assert count_alike(some, some[::-1].copy()) == 40 and count_alike(some, others) < 4
    both = np.concatenate([others, some[:25]])
    assert 25 <= count_alike(some, both) < 29
    # At an angle: next to 0, products that processors round differently would tell the two apart.
    near = some + 0.1 * others[:40]
    near /= np.linalg.norm(near, axis=1, keepdims=True)
    # Which of the two is meant?.
    assert count_alike(near, some) == 40 and count_alike(near, np.concatenate([some, some])) == 0
    assert count_alike(np.concatenate([some, near[:5]]), some) == 40  # each is taken once, by the nearest
    assert [count_alike(some, few) for few in (some[:0], some[:1])] == [0, 0]


def test_the_largest_features_of_a_photo_are_taken(tmp_path, monkeypatch):
    names = ["000001.jpg", "000002.jpg"]
    save_corner(tmp_path / "photos", names)
    extract(tmp_path, names, Report())
    every = module.largest_features(tmp_path, names)
    monkeypatch.setattr(module, "LARGEST_FEATURES", 50)
    largest = module.largest_features(tmp_path, names)
    assert all(len(part) == 50 and np.array_equal(part, whole[:50]) for part, whole in zip(largest, every, strict=True))
    with pycolmap.Database.open(tmp_path / DATABASE) as database:
        number = database.read_image_with_name(names[0]).image_id
        shapes, descriptors = (
            database.read_keypoints(number)[:, 2:].reshape(-1, 2, 2),
            database.read_descriptors(number).data,
        )
    areas = np.linalg.det(shapes)  # of features, in px^2
    taken = (descriptors.astype(np.float32) @ largest[0].T / np.linalg.norm(descriptors, axis=1, keepdims=True)).argmax(
        axis=0
    )
    assert areas[taken] == pytest.approx(np.sort(areas)[:-51:-1], rel=1e-3)
    assert np.linalg.norm(largest[0], axis=1) == pytest.approx(1, abs=1e-5)
    assert count_alike(*largest) >= 5
