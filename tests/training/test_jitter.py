"""What a training step changes about a photo, and that it does not move its mask."""

import pytest
import torch

from core.appearance.model import Look
from core.training.jitter import LARGEST_GAIN, Jitter, draw_jitter
from core.training.photometric import Target
from tests.small import whole_settings


def test_photo_and_target_get_the_same_tone_and_only_the_encoder_sees_the_mirror():
    picture = torch.rand(6, 8, 3, generator=torch.Generator().manual_seed(0)) * 0.7
    jitter = Jitter(torch.tensor([1.3, 1.0, 0.5]), mirrored=True)
    shown, target = jitter.of_photo(picture.permute(2, 0, 1)), jitter.of_target(Target(picture))
    torch.testing.assert_close(shown.flip(-1), target.planes)


def test_a_mask_lies_where_the_photo_was_taken():
    mask = torch.arange(12.0).view(1, 3, 4)
    look = Look(torch.zeros(2), mask)
    assert torch.equal(Jitter(torch.ones(3), mirrored=True).undone(look).mask, mask.flip(-1))
    assert Jitter(torch.ones(3), mirrored=False).undone(look) is look
    assert Jitter(torch.ones(3), mirrored=True).undone(Look(torch.zeros(2), None)).mask is None


def test_every_other_photo_is_mirrored_unless_its_mask_sees_none():
    generator = torch.Generator().manual_seed(0)
    drawn = [draw_jitter(whole_settings(), generator) for _ in range(200)]
    assert 70 < sum(jitter.mirrored for jitter in drawn) < 130
    gains = torch.stack([jitter.gain for jitter in drawn])
    assert 0.1 < float(gains.log().std()) < 0.2 and float(gains.max()) <= LARGEST_GAIN
    assert not any(draw_jitter(whole_settings(mask="mlp"), generator).mirrored for _ in range(20))


@pytest.mark.parametrize("changes", [{"exposure_jitter": 0.0}, {"appearance": "off"}, {"embedding": "glo"}])
def test_what_learns_from_no_photo_or_from_photos_as_they_are_gets_none(changes):
    assert draw_jitter(whole_settings(**changes), torch.Generator()) is None
