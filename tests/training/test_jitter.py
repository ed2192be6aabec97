"""A photo in another exposure: how far it goes, and what of it the encoder is shown."""

import torch

from core.training.jitter import draw_gain, jittered
from core.training.losses.photometric import Target
from tests.small import small_settings


def test_gains_stop_at_their_largest_and_the_encoder_is_shown_nothing_above_one():
    generator, settings = torch.Generator().manual_seed(0), small_settings(exposure_jitter=1.0)
    gains = torch.stack([draw_gain(settings, generator) for _ in range(200)])
    assert gains.max() == torch.tensor(1.4) and gains.min() < 0.2
    few = (
        draw_gain(small_settings(exposure_jitter=0.0), generator),
        draw_gain(small_settings(exposure_jitter=0.1, embedding="glo"), generator),
    )
    assert few == (None, None)
    photo, gain = torch.rand(3, 12, 16), torch.tensor([1.4, 1.0, 0.5])
    shown, target = jittered(photo, Target(photo.permute(1, 2, 0)), gain)
    brightened = photo * gain[:, None, None]
    assert brightened.max() > 1.2
    torch.testing.assert_close(target.planes, brightened)
    torch.testing.assert_close(shown, brightened.clamp(max=1))


def test_exposure_varies_by_what_is_set_and_white_balance_by_half_of_it():
    generator, settings = torch.Generator().manual_seed(0), small_settings(exposure_jitter=0.01)
    gains = torch.stack([draw_gain(settings, generator) for _ in range(2000)]).log()
    exposure = gains.mean(dim=1, keepdim=True)
    assert 0.0099 < exposure.std() < 0.011  # that of white balance adds to it: (1 + 0.25 / 3) ** 0.5
    assert 0.0047 < (gains - exposure).square().sum(dim=1).div(2).mean().sqrt() < 0.0053
