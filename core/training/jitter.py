"""A photo in another exposure and white balance, and maybe mirrored: a collection holds few, and the encoder meets each many times.

It learns to tell tone from light, and passers-by from the side of the picture on which they stood.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from core.appearance.model import Look
from core.config import Settings
from core.device import sent
from core.training.photometric import Target

LARGEST_GAIN = 1.4  # a photo has nothing above 1 to be brightened


@dataclass(frozen=True)
class Jitter:
    """What one step does to a photo. gain: of each channel. mirrored: left to right, for the encoder alone."""

    gain: Float[Tensor, "3"]
    mirrored: bool

    def of_photo(self, shown: Float[Tensor, "3 h w"]) -> Float[Tensor, "3 h w"]:
        """What the encoder sees."""
        shown = (shown * sent(self.gain, shown.device)[:, None, None]).clamp(max=1.0)
        return shown.flip(-1) if self.mirrored else shown

    def of_target(self, target: Target) -> Target:
        """What the render is compared with."""
        return target.brightened(sent(self.gain, target.planes.device))

    def undone(self, look: Look) -> Look:
        """The look of the photo as it was taken."""
        if not self.mirrored or look.mask is None:
            return look
        return Look(look.embedding, look.mask.flip(-1))


def draw_jitter(settings: Settings, generator: torch.Generator) -> Jitter | None:
    """A random one, or None where looks are not learnt from photos. The MLP's mask sees no photo, so that is not mirrored for it."""
    if not settings.exposure_jitter or settings.appearance == "off" or settings.embedding == "glo":
        return None
    draw = torch.randn(4, generator=generator)
    gain = torch.exp(settings.exposure_jitter * (draw[:1] + 0.5 * draw[1:])).clamp(max=LARGEST_GAIN)
    return Jitter(gain, mirrored=bool(torch.rand((), generator=generator) < 0.5) and settings.mask != "mlp")
