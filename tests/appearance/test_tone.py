"""Gains of place and sky: found from bands of colours, taken off a photo, put on Gaussians."""

import pytest
import torch

from core.appearance.tone import BANDS, LARGEST_GAIN, LEAST_GAIN, TOWARD_ONE, band_means, taken_off, tone_between, toned
from core.scene.harmonics import colour
from tests.appearance.test_model import splats_of

SKY_ABOVE = torch.tensor([[0.1, 0.3, 0.5, 0.5], [0.6, 0.3, 0.1, 0.0]])[..., None].expand(2, BANDS, 3)  # place, sky


def test_every_colour_is_multiplied_by_its_gain():
    splats = splats_of(30)
    tone = torch.tensor([[0.5, 1.2, 0.0], [0.02, 1.0, 1.4]])
    directions = torch.nn.functional.normalize(torch.randn(len(splats), 3), dim=1)
    gains = torch.cat([tone[:1].expand(len(splats) - 10, 3), tone[1:].expand(10, 3)])
    expected = colour(splats.sh, directions) * gains
    torch.testing.assert_close(colour(toned(splats, tone, 10).sh, directions), expected, rtol=0, atol=2e-6)
    assert torch.equal(toned(splats, torch.ones(2, 3), 10).sh, splats.sh)


def test_a_black_sky_above_a_lit_place_is_found():
    wanted = SKY_ABOVE[0] * torch.tensor([0.9, 0.6, 0.4]) + SKY_ABOVE[1] * 0.05
    found = tone_between(SKY_ABOVE, wanted)
    # Drawn toward 1 a little.
    torch.testing.assert_close(found, torch.tensor([[0.9, 0.6, 0.4], [0.05] * 3]), rtol=0, atol=0.04)
    bright = tone_between(SKY_ABOVE, torch.full((BANDS, 3), 0.9))
    assert bright.max() == pytest.approx(LARGEST_GAIN)
    assert tone_between(SKY_ABOVE, torch.zeros(BANDS, 3)).max() < 0.1


def test_no_tone_within_bounds_fits_better():
    generator = torch.Generator().manual_seed(1)
    for _ in range(20):
        brought, wanted = torch.rand(2, BANDS, 3, generator=generator), torch.rand(BANDS, 3, generator=generator)

        def cost(tone, brought=brought, wanted=wanted):
            missed = (brought * tone[:, None]).sum(dim=0) - wanted
            return missed.square().sum(dim=0) + TOWARD_ONE**2 * (tone - 1).square().sum(dim=0)

        found = tone_between(brought, wanted)
        assert ((found >= LEAST_GAIN - 1e-6) & (found <= LARGEST_GAIN + 1e-6)).all()
        others = LEAST_GAIN + (LARGEST_GAIN - LEAST_GAIN) * torch.rand(500, 2, 3, generator=generator)
        assert all((cost(found) <= cost(other) + 1e-6).all() for other in others)


def test_without_a_sky_its_gain_stays_one():
    brought = torch.stack([SKY_ABOVE[0], torch.zeros(BANDS, 3)])
    found = tone_between(brought, 0.3 * SKY_ABOVE[0])
    assert torch.equal(found[1], torch.ones(3))
    torch.testing.assert_close(found[0], torch.full((3,), 0.3), rtol=0, atol=0.02)


def test_what_is_taken_off_a_photo_is_the_gain_of_its_rows():
    """One gain everywhere divides by it; two lead back to the bands that place and sky bring."""
    picture = 0.4 * torch.rand(3, 40, 30)
    one = torch.tensor([0.5, 0.8, 1.25]).expand(2, 3)
    torch.testing.assert_close(taken_off(picture, one, SKY_ABOVE), picture / one[0][:, None, None], rtol=0, atol=1e-5)
    tone = torch.stack([torch.full((3,), 0.8), torch.full((3,), 0.1)])
    shown = (SKY_ABOVE * tone[:, None]).sum(dim=0)
    rows = shown.T[:, :, None, None].expand(3, BANDS, 10, 20).reshape(3, 10 * BANDS, 20)
    torch.testing.assert_close(band_means(taken_off(rows, tone, SKY_ABOVE)), SKY_ABOVE.sum(dim=0), rtol=0, atol=0.15)
    assert torch.equal(taken_off(picture, one, torch.zeros(2, BANDS, 3)), picture)  # views of nothing
