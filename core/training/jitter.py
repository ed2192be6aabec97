"""A photo in another exposure and white balance, for the encoder and as the target alike.

A collection holds few photos; with this the encoder meets each in many tones and learns to tell tone from light.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from core.training.photometric import Target

LARGEST_GAIN = 1.4  # a photo has nothing above 1 to be brightened


def jittered(
    shown: Float[Tensor, "3 h w"], target: Target, spread: float, generator: torch.Generator
) -> tuple[Float[Tensor, "3 h w"], Target]:
    """Both with each channel times a random gain. spread: of the log of the gain common to the channels; their own is half of it."""
    draw = torch.randn(4, generator=generator)
    gain = torch.exp(spread * (draw[:1] + 0.5 * draw[1:])).clamp(max=LARGEST_GAIN)
    return (shown * gain[:, None, None]).clamp(max=1.0), target.brightened(gain)
