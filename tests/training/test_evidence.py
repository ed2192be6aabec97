"""Figures about looks, each found in sightings that were made to have a known one."""

from dataclasses import replace
from functools import reduce

import cv2
import numpy as np
import pytest

from core.run.sized_photo import Sizes
from core.training.evidence import (
    Evidence,
    exposed,
    exposures_of,
    fit_exposures,
    gather_evidence,
    shared_spread,
    strange_share,
    view_dependence,
)
from core.training.sightings import (
    NEAR_DEGREES,
    Sightings,
    _degrees_to_nearest,
    find_sightings,
    neighbours,
    rows_of_each,
)
from core.training.sized_photos import SizedPhotos
from tests.training.known_scene import HEIGHT, WIDTH, crowded, known_collection, plain

PHOTOS, POINTS = 20, 300


@pytest.fixture
def random():
    return np.random.default_rng(3)


def sightings(random, colour=None) -> Sightings:
    """Every photo matches every point, at a place of its own;
    colours grey unless given by (photo, point, pixel, towards)."""
    photo, point = (grid.ravel() for grid in np.meshgrid(np.arange(PHOTOS), np.arange(POINTS), indexing="ij"))
    towards = random.normal(size=(len(photo), 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    pixel = random.uniform(0, 0.7, (len(photo), 2))
    colours = np.full((len(photo), 3), 0.5) if colour is None else colour(photo, point, pixel, towards)
    nearest = random.uniform(0, NEAR_DEGREES, len(photo))
    return Sightings(photo, point, pixel, colours, towards, np.ones(len(photo), bool), nearest)


# --- what photos share, and what is noise


def test_noise_of_each_place_does_not_count(random):
    noise = 10 / 255 * random.normal(size=(PHOTOS * POINTS, 3))
    # The mean product of independent pairs is 0 within 10^2 / sqrt(6000) = 1.3 steps^2.
    made = sightings(random)
    assert shared_spread(made, neighbours(made), noise) < 2.0


@pytest.mark.parametrize("photos", [PHOTOS, 4])
def test_what_neighbours_share_counts_in_full(random, photos):
    made = sightings(random)
    made = made[made.photo < photos]
    shift = 12 / 255 * random.normal(size=(photos, 3))
    noise = 6 / 255 * random.normal(size=(len(made), 3))
    # The mean over the photos is taken off.
    expected = 255 * np.sqrt((shift**2).mean()) * np.sqrt(photos / (photos - 1))
    assert shared_spread(made, neighbours(made), shift[made.photo] + noise) == pytest.approx(expected, rel=0.05)


def test_a_few_wrong_matches_do_not_decide(random):
    made = sightings(random)
    difference = 1 / 255 * random.normal(size=(len(made), 3))
    for rows in rows_of_each(made.photo):
        block = rows[(made.pixel[rows] < 0.07).all(axis=1)]  # a hundredth of the photo, all of it white
        difference[block] = 1.0
    assert shared_spread(made, neighbours(made), difference) < 2.0


def test_neighbours_are_in_the_same_photo_and_do_not_share_their_blur(random):
    made = sightings(random)
    first, second = neighbours(made)
    apart = np.linalg.norm(made.pixel[first] - made.pixel[second], axis=1)
    assert (made.photo[first] == made.photo[second]).all() and apart.min() >= 4 * 0.003
    assert len(first) > 0.95 * len(made) and np.median(apart) < 0.05


def test_points_that_crowd_in_a_small_part_of_the_photos_have_neighbours_as_well(random):
    """A small subject has dozens of them within one blur. They were left out, and nothing differed or looked strange."""
    made = sightings(random)
    made = replace(made, pixel=made.pixel / 14)
    first, second = neighbours(made)
    assert np.array_equal(np.sort(first), np.arange(len(made)))
    here = made.photo[first] == 0
    first, second = made.pixel[first[here]], made.pixel[second[here]]
    distances = np.linalg.norm(first[:, None] - made.pixel[made.photo == 0], axis=2)
    nearest = np.where(distances < 4 * 0.003, np.inf, distances).min(axis=1)
    np.testing.assert_allclose(np.linalg.norm(first - second, axis=1), nearest)


# --- exposures


def test_exposures_are_found_among_wrong_matches(random):
    base = random.uniform(0.2, 0.8, (POINTS, 3))
    gain, offset = random.uniform(0.6, 1.2, (PHOTOS, 3)), random.uniform(-0.1, 0.1, (PHOTOS, 3))

    def colour(photo, point, pixel, towards):
        colours = gain[photo] * base[point] + offset[photo]
        colours[random.uniform(size=len(photo)) < 0.05] = 1.0
        return colours

    made = sightings(random, colour)
    found = exposures_of(made.photo, base[made.point], made.colour)
    np.testing.assert_allclose(found[:, 0], gain, atol=0.03)  # the prior of 0.4 matches, against 300
    np.testing.assert_allclose(found[:, 1], offset, atol=0.03)
    bases, exposures = fit_exposures(made)  # of unknown base colours: only what they give together is known
    left = np.abs(made.colour - exposed(exposures, made.photo, bases[made.point])).max(axis=1)
    assert np.quantile(left, 0.9) < 3 / 255


def test_a_photo_of_one_colour_has_an_exposure_all_the_same(random):
    made = sightings(random)  # all is grey: gain and offset cannot be told apart
    found = exposures_of(made.photo, made.colour, made.colour)
    np.testing.assert_allclose(found[:, 0] * 0.5 + found[:, 1], 0.5, atol=1e-3)


# --- view dependence


@pytest.mark.parametrize("strength, noise, low, high", [(30, 5, 0.9, 1.0), (5, 30, 0.0, 0.1), (0, 10, 0.0, 0.02)])
def test_the_share_of_the_viewing_direction(random, strength, noise, low, high):
    made = sightings(random)
    shine = strength * np.einsum("ni,ni->n", made.towards, random.normal(size=(POINTS, 3))[made.point])[:, None]
    difference = (shine + noise * random.normal(size=(len(made), 3))) / 255
    assert low <= view_dependence(made, difference) <= high


def test_points_that_few_photos_see_say_nothing_of_directions(random):
    made = sightings(random)
    assert view_dependence(made[made.photo < 6], np.ones((6 * POINTS, 3))) is None


# --- passers-by


def test_places_that_look_strange_side_by_side_are_counted(random):
    made = sightings(random)
    difference = 1 / 255 * random.normal(size=(len(made), 3))
    assert strange_share(made, difference) == 0
    alone = random.permutation(len(made))[:60]
    scattered = difference.copy()
    scattered[alone] = 0.5  # wrong matches: one here, one there
    assert strange_share(made, scattered) < 0.002
    hidden = (made.pixel > 0.2).all(axis=1) & (made.pixel < 0.4).all(axis=1)
    there = difference.copy()
    there[hidden] = 0.5
    # Places at the rim have a neighbour outside: up to a fifth are lost.
    assert 0.8 * hidden.mean() < strange_share(made, there) <= 1.2 * hidden.mean()


def test_without_photos_from_nearby_nothing_is_said_of_passers_by(random):
    made = sightings(random)
    far = replace(made, degrees=np.full(len(made), NEAR_DEGREES + 1))
    assert strange_share(far, np.zeros((len(made), 3))) is None


# --- from photos


def test_sightings_are_where_the_points_are_and_expected_where_nearby_photos_see_them(tmp_path):
    collection = known_collection(tmp_path, photos=8)
    photos = SizedPhotos(collection.photos, Sizes(1, 32)).photos
    hidden = photos[3].photo.points[:40]
    fewer = replace(photos[3], photo=replace(photos[3].photo, points=photos[3].photo.points[40:]))
    found = find_sightings(collection.points, [*photos[:3], fewer, *photos[4:]])
    here = found[found.photo == 3]
    # Of the 40 that photo 3 now misses, those that two more photos match are expected there; some have others in front.
    expected = here[~here.matched]
    again = find_sightings(collection.points, photos)
    before = again[(again.photo == 3) & ~again.matched]
    assert 10 < len(expected) - len(before) <= len(hidden)
    assert (expected.degrees <= NEAR_DEGREES).all() and expected.degrees.min() > 1
    pixel = here.pixel * np.hypot(160, 120)
    colours = photos[3].pixels[pixel[:, 1].astype(int), pixel[:, 0].astype(int)] / 255
    assert np.abs(colours - here.colour).mean() < 0.02  # noise of 2 / 255, and the blur
    np.testing.assert_allclose(np.linalg.norm(here.towards, axis=1), 1, atol=1e-12)


def test_texture_finer_than_features_are_off_is_no_colour(tmp_path):
    collection = known_collection(tmp_path, plain, photos=4)
    photos = SizedPhotos(collection.photos, Sizes(1, 32)).photos
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    chequered = np.repeat(255 * ((rows + columns) % 2)[..., None], 3, axis=2).astype(np.uint8)
    found = find_sightings(collection.points, [replace(photo, pixels=chequered) for photo in photos])
    assert np.abs(found.colour - 0.5).max() < 0.1


def test_large_photos_are_shrunk_before_they_are_blurred(tmp_path, monkeypatch):
    collection = known_collection(tmp_path, plain, photos=4)
    photos = [
        replace(
            photo,
            pixels=cv2.resize(photo.pixels, None, fx=12, fy=12, interpolation=cv2.INTER_CUBIC),
            camera=photo.camera.resized(12 * WIDTH, 12 * HEIGHT),
        )
        for photo in SizedPhotos(collection.photos, Sizes(1, 32)).photos
    ]
    shrunk = find_sightings(collection.points, photos)
    monkeypatch.setattr("core.training.sightings.BLURRED_PIXELS", 1 << 30)
    found = find_sightings(collection.points, photos)
    assert 255 * np.abs(shrunk.colour - found.colour).max() < 1 and not np.array_equal(shrunk.colour, found.colour)
    assert np.array_equal(shrunk.pixel, found.pixel)


def test_colours_of_a_shrunken_photo_are_those_of_the_same_places(tmp_path):
    """Of ramps in a photo 1601 px wide, which does not shrink to whole pixels."""
    collection, width, height = known_collection(tmp_path, plain, photos=4), 1601, 1201
    ramps = np.abs(np.mod(np.arange(width) + 0.5, 400) - 200) * 255 / 200
    pixels = np.broadcast_to(ramps[None, :, None], (height, width, 3)).round().astype(np.uint8)
    photos = [
        replace(photo, pixels=pixels, camera=photo.camera.resized(width, height))
        for photo in SizedPhotos(collection.photos, Sizes(1, 32)).photos
    ]
    found = find_sightings(collection.points, photos)
    column = found.pixel[:, 0] * np.hypot(width, height)
    straight = np.abs(np.mod(column, 200) - 100) < 60
    expected = np.abs(np.mod(column, 400) - 200) / 200
    assert straight.sum() > 100 and 200 * np.abs(found.colour[:, 0] - expected)[straight].max() < 0.3  # px


def test_a_photo_is_near_another_that_looks_at_a_point_from_as_far_away():
    """Two of three are 4 degrees apart, as seen from the point;
    the third is in line with one of them, twice as far off."""
    rays = np.array([[[0.0, 0.0, 1.0], [np.sin(np.radians(4)), 0.0, np.cos(np.radians(4))], [0.0, 0.0, 1.0]]])
    distances = np.array([[3.0, 4.0, 6.5]])
    for matched, expected in (
        ([True, True, True], [4, 4, 180]),
        ([True, False, True], [180, 4, 180]),
        ([False, True, False], [4, 180, 180]),
    ):
        np.testing.assert_allclose(_degrees_to_nearest(rays, distances, np.array([matched])), [expected], atol=1e-6)


def test_points_are_seen_where_a_photo_is_valid_and_not_empty(tmp_path):
    collection = known_collection(tmp_path, plain, photos=8)
    photos = SizedPhotos(collection.split("train"), Sizes(1, 32)).photos
    everywhere = find_sightings(collection.points, photos)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    empty, valid = (255 * (columns < WIDTH // 2)).astype(np.uint8), rows >= HEIGHT // 2
    cut = find_sightings(collection.points, [replace(photo, empty=empty, valid=valid) for photo in photos])
    line, column = cut.pixel[:, 1], cut.pixel[:, 0]
    diagonal = np.hypot(WIDTH, HEIGHT)
    assert 0 < len(cut) < len(everywhere) / 2
    assert column.min() * diagonal >= WIDTH // 2 and line.min() * diagonal >= HEIGHT // 2


def test_a_point_behind_others_is_not_expected(tmp_path):
    """The place itself may hide it: only points that ought to be visible tell of passers-by."""
    collection = known_collection(tmp_path, photos=8)
    photos = SizedPhotos(collection.photos, Sizes(1, 32)).photos
    found = find_sightings(collection.points, photos)
    expected = found[~found.matched]
    possible = len(photos) * len(np.unique(found.point)) - found.matched.sum()
    assert len(expected) < 0.35 * possible  # a ball of points: most of those not matched lie on its far side


def test_too_few_points_give_no_figures(tmp_path):
    collection = known_collection(tmp_path, photos=6)
    photos = SizedPhotos(collection.photos, Sizes(1, 32)).photos
    few = [replace(p, photo=replace(p.photo, points=p.photo.points[:30])) for p in photos]
    assert gather_evidence(collection.points, few).colour_spread is None
    shared = reduce(np.intersect1d, [p.photo.points for p in photos])[:60]
    assert gather_evidence(
        collection.points, [replace(p, photo=replace(p.photo, points=shared)) for p in photos]
    ) == Evidence(len(photos))
    none = [replace(p, photo=replace(p.photo, points=p.photo.points[:0])) for p in photos]
    assert gather_evidence(collection.points, none) == Evidence(len(none))
    assert gather_evidence(collection.points, photos[:1]).colour_spread is None


def test_a_photo_that_shares_its_points_with_none_is_not_judged(tmp_path):
    collection = known_collection(tmp_path, photos=6)
    photos = SizedPhotos(collection.photos, Sizes(1, 32)).photos
    own, shared = np.arange(60), np.arange(60, len(collection.points))
    seen = [shared] * 5 + [own]
    photos = [
        replace(p, photo=replace(p.photo, points=np.intersect1d(p.photo.points, s)))
        for p, s in zip(photos, seen, strict=True)
    ]
    found = gather_evidence(collection.points, photos)
    assert (
        replace(found, photos=5) == gather_evidence(collection.points, photos[:5]) and found.colour_spread is not None
    )


def test_figures_do_not_change_from_call_to_call(tmp_path):
    collection = known_collection(tmp_path, crowded, photos=12)
    photos = SizedPhotos(collection.photos, Sizes(1, 32)).photos
    assert gather_evidence(collection.points, photos) == gather_evidence(collection.points, photos)
