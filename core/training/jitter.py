"""A photo in another exposure and white balance, for the encoder and as the target alike.

A collection holds few photos; with this the encoder sees each in many tones, and learns to tell tone from light.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from core.appearance.tone import LARGEST_GAIN
from core.config import Settings
from core.training.losses.photometric import Target


def draw_gain(settings: Settings, generator: torch.Generator) -> Float[Tensor, "3"] | None:
    """A random gain per channel, or None where looks are not learned from photos."""
    if not (settings.exposure_jitter and settings.encodes_photos):
        return None
    draw = torch.randn(4, generator=generator)
    return torch.exp(settings.exposure_jitter * (draw[:1] + 0.5 * draw[1:])).clamp(max=LARGEST_GAIN)


def jittered(
    shown: Float[Tensor, "3 h w"], target: Target, gain: Float[Tensor, "3"] | None
) -> tuple[Float[Tensor, "3 h w"], Target]:
    """The encoder's input and the target, each channel times its gain, on the same device; unchanged for None.

    The encoder sees a photo as a file would hold it, so its input is clamped at 1. The target is not, as no render is:
    its statistics then follow from those of the photo.
    """
    if gain is None:
        return shown, target
    return (shown * gain[:, None, None]).clamp(max=1.0), target.brightened(gain)
