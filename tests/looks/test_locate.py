"""The camera of a photo that is no photo of the scene: what is accepted, and how a start becomes a camera."""

import numpy as np
import pytest
import torch

from core.data import load_collection
from core.data.sfm.pose import pinhole_of
from core.looks import locate as locating
from core.looks.find_look import find_look
from core.looks.locate import FINE_PX, WIDER, Located, _iterate, _query_at, _with_other_focal_lengths, locate
from core.looks.trained import bake, neutral_look
from core.report import Report
from tests.data.room_corner import HEIGHT, WIDTH


@pytest.mark.parametrize(
    ("inliers", "matches", "is_found"), [(120, 237, False), (100, 107, True), (400, 740, True), (60, 60, False)]
)
def test_the_smaller_the_share_that_agrees_the_more_must_agree(trained, monkeypatch, inliers, matches, is_found):
    """120 of 237 agree by chance where a photo is too blurred to show anything; 100 of 107 where one is tiny."""
    photo = trained.collection.photo("0.png")
    end = Located(photo.camera, inliers, matches)
    monkeypatch.setattr("core.looks.locate._iterate", lambda *_: end)
    found = locate(trained, find_look(trained, "0.png", refine=False), photo.path, None, Report())
    assert (found is not None) == is_found


@pytest.mark.parametrize(
    ("inliers", "best", "rounds"),
    [((427, 423, 491, 490, 489, 900), 491, 5), ((50, 51, 51, 51), 51, 4), ((50, None, 90), 50, 2), ((None,), None, 1)],
)
def test_iterating_ends_after_two_rounds_in_vain(trained, monkeypatch, inliers, best, rounds):
    """Inliers may fall by chance on the way to the camera."""
    photo, asked = trained.collection.photo("0.png"), []
    query = _query_at(photo, pinhole_of(photo.path, WIDTH, HEIGHT), FINE_PX)

    def solve(*given):
        asked.append(given)
        found = inliers[len(asked) - 1]
        return None if found is None else Located(photo.camera, found, 1000)

    monkeypatch.setattr("core.looks.locate._solve_pose", solve)
    end = _iterate(trained, trained.splats, query, photo.camera)
    assert (end and end.inliers) == best and len(asked) == rounds


def test_other_focal_lengths_see_the_place_as_large_and_the_best_is_taken(trained, monkeypatch):
    photo, asked = trained.collection.photo("4.png"), []
    query = _query_at(photo, pinhole_of(photo.path, WIDTH, HEIGHT), FINE_PX)
    baked, camera = bake(trained, neutral_look(trained)), photo.camera
    inliers = iter((520, 700, 705, 690))  # wider, again wider, no more; narrower is no better

    def iterate(trained, baked, query, start):
        asked.append(start)
        return Located(start, next(inliers), 1000)

    monkeypatch.setattr(locating, "_iterate", iterate)
    with torch.no_grad():
        best = _with_other_focal_lengths(trained, baked, query, Located(camera, 500, 1000))
    assert best == Located(asked[1], 700, 1000)
    assert [start.fx / camera.fx for start in asked] == pytest.approx([WIDER, WIDER**2, WIDER**3, WIDER])
    moved, axis = asked[0].centre - camera.centre, camera.world_to_camera[2]
    points = load_collection(trained.collection.read_from).points  # a run keeps none
    _, depths = camera.project(points[camera.shows(points)[0]])
    assert np.allclose(moved, axis * (moved @ axis))
    assert moved @ axis == pytest.approx(np.median(depths) * (1 - WIDER), rel=0.2)
