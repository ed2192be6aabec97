"""Landmarks, by which photos from outside are located:
which features show which SfM points, and the file that keeps them."""

from dataclasses import replace

import numpy as np

from core.data.sfm.landmarks import LENGTH, NEAR_PX, NO_POINT, Landmarks, landmarks_of
from core.report import Report
from core.scene.frame import SceneFrame


def test_every_feature_of_the_training_photos_is_kept_and_what_it_shows(corner, known):
    assert len(known.counts) == len(corner.split("train")) == 5 and (known.counts > 100).all()
    assert known.descriptors.shape == (known.counts.sum(), LENGTH) and known.descriptors.std() > 10
    starts = np.cumsum(known.counts) - known.counts
    for photo, start, count in zip(corner.split("train"), starts, known.counts, strict=True):
        shown = known.shows[start : start + count]
        assert 0.2 < (shown != NO_POINT).mean() <= 1
        assert set(shown) - {NO_POINT} <= set(photo.points.tolist())


def test_features_farther_than_two_pixels_from_every_point_show_none(corner, known):
    assert NEAR_PX == 2
    photo = corner.split("train")[0]
    few = replace(photo, points=photo.points[:2])
    lone = landmarks_of(replace(corner, photos=(few,)), Report())
    assert lone.counts.tolist() == [known.counts[0]]
    assert 1 <= (lone.shows != NO_POINT).sum() <= 20 and set(lone.shows) <= {NO_POINT, *few.points.tolist()}


def test_the_file_holds_them_bit_for_bit(known, tmp_path):
    known.save(tmp_path / "kept.npz", "abc")
    kept = Landmarks.load(tmp_path / "kept.npz", "abc")
    assert all(np.array_equal(one, other) for one, other in zip(vars(known).values(), vars(kept).values(), strict=True))
    assert [path.name for path in tmp_path.iterdir()] == ["kept.npz"]


def test_a_file_of_another_run_is_not_read(known, tmp_path):
    path = tmp_path / "kept.npz"
    known.save(path, "abc")
    assert Landmarks.load(path, "other") is None
    np.savez(path, **vars(known))  # as wegs once kept them
    assert Landmarks.load(path, "abc") is None


def test_a_missing_or_damaged_file_is_not_read(known, tmp_path):
    path = tmp_path / "kept.npz"
    assert Landmarks.load(path, "abc") is None
    known.save(path, "abc")
    whole = path.read_bytes()
    # Of the first entry in the zip's table; 1 is encrypted, 0x20 patched data, which Python refuses.
    flags = whole.index(b"PK\x01\x02") + 8
    encrypted, patched = (whole[:flags] + bytes([whole[flags] | flag]) + whole[flags + 1 :] for flag in (1, 0x20))
    for damaged in (b"", whole[:1000], whole[:-100], b"no zip at all" * 20, encrypted, patched):
        path.write_bytes(damaged)
        assert Landmarks.load(path, "abc") is None


def test_landmarks_can_be_moved_into_another_frame_of_the_same_world(known):
    own, other = SceneFrame(np.array([1.0, 2.0, 3.0]), 2.0), SceneFrame(np.array([-1.0, 0.0, 5.0]), 0.5)
    moved = known.in_frame(own, other)
    np.testing.assert_allclose(other.to_world(moved.points), own.to_world(known.points), atol=1e-9)
    assert np.array_equal(moved.shows, known.shows)
