"""The tone of a photo whose light no look holds: one gain of the sky and one of the place, per channel.

Training jitters exposure and white balance of each photo, for the encoder and as the target alike. So a gain may be
divided out of a photo before it is encoded, and applied to the Gaussians of the look that results: colours are linear
in their coefficients. Sky and place have one each: at night the sky is black and the place is lit.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from core.scene.harmonics import dc_of_colour
from core.scene.splats import Splats

BANDS = 4  # horizontal ones of a photo, whose mean colours tell sky from place
# The share of a band that moves a gain half of the way from 1; 0.05 to 0.4 are within 0.1 dB of each other.
TOWARD_ONE = 0.1
# Darker is nearly black in 8 bits; brighter is beyond the jitter of training, which is clamped here, too.
LEAST_GAIN, LARGEST_GAIN = 0.02, 1.4
ROUNDS = 100  # of coordinate descent
EPSILON = 1e-6  # makes 0 / 0 a gain of 1, in bands where views show nothing


def band_means(picture: Float[Tensor, "3 h w"]) -> Float[Tensor, "bands 3"]:
    """The mean colours of a picture from top to bottom."""
    return F.adaptive_avg_pool2d(picture, (BANDS, 1))[..., 0].T


def tone_between(layers: Float[Tensor, "2 bands 3"], wanted: Float[Tensor, "bands 3"]) -> Float[Tensor, "2 3"]:
    """The tone in which what place and sky add to the mean colours of the bands, the layers,
    comes nearest to those wanted.

    Least squares |g_place P + g_sky S - wanted|^2 + TOWARD_ONE^2 |g - 1|^2 per channel, by coordinate descent;
    LEAST_GAIN <= g <= LARGEST_GAIN.
    """
    place, sky = layers.double()
    wanted = wanted.double()
    weight = TOWARD_ONE**2
    tone = torch.ones_like(layers[:, 0]).double()
    for _ in range(ROUNDS):
        for row, mine, other in ((0, place, sky), (1, sky, place)):
            left = wanted - other * tone[1 - row]
            tone[row] = ((mine * left).sum(dim=0) + weight) / (mine.square().sum(dim=0) + weight)
            tone[row].clamp_(LEAST_GAIN, LARGEST_GAIN)
    return tone.float()


def taken_off(
    picture: Float[Tensor, "3 h w"], tone: Float[Tensor, "2 3"], layers: Float[Tensor, "2 bands 3"]
) -> Float[Tensor, "3 h w"]:
    """The photo without the tone, in [0, 1]: every row divided by the gain of what place and sky add up to there."""
    with_tone, without = ((layers * gain).sum(dim=0) + EPSILON for gain in (tone[:, None], 1.0))
    rows = F.interpolate((with_tone / without).T[None], size=picture.shape[1], mode="linear", align_corners=False)[0]
    return (picture / rows[..., None]).clamp(max=1.0)


def toned(splats: Splats, tone: Float[Tensor, "2 3"], sky_count: int) -> Splats:
    """The Gaussians, the last `sky_count` of which are the dome, with every colour times its gain;
    exactly, as max(0, c) keeps to gains >= 0."""
    place = len(splats) - sky_count
    gains = torch.cat([tone[:1].expand(place, 3), tone[1:].expand(sky_count, 3)]).to(splats.sh)
    sh = splats.sh * gains[:, None]
    sh[:, 0] += dc_of_colour(0.5 * gains)  # a colour is 0.5 + what its coefficients say
    return splats.with_sh(sh)
