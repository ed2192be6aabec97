"""The sky of looks: every disc of the dome takes its colour from those that training photos show."""

import numpy as np
import pytest
import torch

import core.rasterizer
from core.looks import smooth_sky
from core.looks.smooth_sky import LENGTH_DEGREES, NOISE, SmoothSky
from core.scene.camera import Camera
from core.scene.harmonics import colour, dc_of_colour
from core.scene.splats import Splats
from core.training.gaussians.initialisation import sky_dome
from tests.small import small_collection, whole_settings

DISCS = 200
RASTERIZER = core.rasterizer.create("cpu")
# Three that look to one side, the first two at nearly the same discs.
CAMERAS = [
    Camera(
        np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]]),
        np.zeros(3),
        90.0,
        90.0,
        60.0,
        45.0,
        120,
        90,
    )
    for turn in (0.0, 0.2, 0.6)
]


@pytest.fixture
def dome(tmp_path) -> Splats:
    """A dome that is brighter and bluer towards y, one colour a disc."""
    splats = sky_dome(small_collection(tmp_path), whole_settings(sky_gaussians=DISCS))
    heights = torch.nn.functional.normalize(splats.means, dim=1)[:, 1:2]
    sh = torch.zeros_like(splats.sh)
    sh[:, 0] = dc_of_colour(0.5 + 0.3 * heights * torch.tensor([[0.5, 0.8, 1.0]]))
    return splats.with_sh(sh)


def colours_of(splats: Splats):
    return colour(splats.sh, torch.nn.functional.normalize(splats.means, dim=1))


def test_what_no_photo_shows_continues_the_sky_that_photos_show(dome):
    sky = SmoothSky.of(dome, DISCS, CAMERAS, RASTERIZER)
    hidden = torch.ones(DISCS, dtype=torch.bool)
    hidden[sky.shown] = False
    assert 0.4 < hidden.float().mean() < 0.9
    truth, learned = colours_of(dome), dome.sh.clone()
    learned[hidden] = dc_of_colour(torch.rand(int(hidden.sum()), 1, 3)).expand(-1, learned.shape[1], 3)
    after = colours_of(sky.over(dome.with_sh(learned)))
    assert torch.equal(after, colours_of(sky.over(dome)))  # whatever hidden discs began with says nothing
    grey = truth[sky.shown].mean(dim=0)
    assert (after - truth)[hidden].abs().mean() < 0.7 * (grey - truth)[hidden].abs().mean()
    assert (after - truth)[sky.shown].abs().mean() < 0.5 * (grey - truth)[sky.shown].abs().mean()


def test_the_weights_solve_the_kriging_system_and_leave_a_sky_of_one_colour_as_it_is(dome):
    sky = SmoothSky.of(dome, DISCS, CAMERAS, RASTERIZER)
    directions = torch.nn.functional.normalize(dome.means.double(), dim=1)
    covariance = torch.exp(-(directions @ directions.T).clamp(-1, 1).arccos().rad2deg() / LENGTH_DEGREES)
    photos = sum(RASTERIZER.contributions(dome, camera.shrunk(100 / 120)).double() for camera in CAMERAS)
    assert torch.equal(photos.nonzero()[:, 0], sky.shown)
    count = len(sky.shown)
    system = torch.ones(count + 1, count + 1, dtype=torch.float64)
    system[:count, :count] = covariance[sky.shown][:, sky.shown] + torch.diag(NOISE / photos[sky.shown])
    system[count, count] = 0
    given = torch.cat([covariance[sky.shown], torch.ones(1, DISCS, dtype=torch.float64)])
    expected = torch.linalg.solve(system, given)[:count].T
    torch.testing.assert_close(sky.weights, expected.float(), rtol=0, atol=1e-6)
    plain = dome.with_sh(dc_of_colour(torch.tensor([0.2, 0.4, 0.9])).expand_as(dome.sh[:, :1]))
    even = SmoothSky.of(plain, DISCS, CAMERAS, RASTERIZER).over(plain)
    torch.testing.assert_close(even.sh, plain.sh, rtol=0, atol=1e-5)


def test_a_disc_has_the_colour_that_it_shows_towards_the_scene_from_everywhere(dome):
    """Its higher bands are of the directions that it was seen from; other discs are seen from others."""
    sh = dome.sh.clone()
    assert sh.shape[1] == 4
    directions = torch.nn.functional.normalize(dome.means, dim=1)
    sh[:, 1:] = 0.1 * torch.rand(DISCS, 1, 3) * directions[:, [1, 2, 0], None]
    sky = SmoothSky.of(dome, DISCS, CAMERAS, RASTERIZER)
    tilted = dome.with_sh(sh)
    flat = torch.zeros_like(sh)
    flat[:, 0] = dc_of_colour(colours_of(tilted))
    after = sky.over(tilted).sh
    assert not after[:, 1:].any()
    torch.testing.assert_close(after, sky.over(dome.with_sh(flat)).sh, rtol=0, atol=1e-5)


def test_of_a_dome_of_very_many_discs_some_give_their_colour(dome, monkeypatch):
    every = SmoothSky.of(dome, DISCS, CAMERAS, RASTERIZER)
    monkeypatch.setattr(smooth_sky, "MOST", len(every.shown) - 1)
    some = SmoothSky.of(dome, DISCS, CAMERAS, RASTERIZER)
    assert torch.equal(some.shown, every.shown[::2])
    assert (colours_of(some.over(dome)) - colours_of(every.over(dome))).abs().max() < 0.02


def test_a_disc_that_is_not_finite_says_nothing_of_the_others(dome):
    shown = SmoothSky.of(dome, DISCS, CAMERAS, RASTERIZER).shown
    sh = dome.sh.clone()
    sh[shown[0]] = torch.nan
    broken = dome.with_sh(sh)
    sky = SmoothSky.of(broken, DISCS, CAMERAS, RASTERIZER)
    assert shown[0] not in sky.shown and sky.over(broken).finite_rows().all()


def test_without_a_dome_or_photos_of_it_there_is_no_such_sky(dome):
    assert SmoothSky.of(dome, 0, CAMERAS, RASTERIZER) is None
    assert SmoothSky.of(dome, DISCS, [], RASTERIZER) is None


def test_the_sky_is_the_same_for_any_number_of_threads(dome, on_threads):
    def found():
        sky = SmoothSky.of(dome, DISCS, CAMERAS, RASTERIZER)
        return sky.weights, sky.over(dome).sh

    first, *others = on_threads((1, 2, 3), found)
    for other in others:
        assert all(torch.equal(*pair) for pair in zip(first, other))
