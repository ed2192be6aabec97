"""How far pictures are from the true ones."""

import torch
from torch import Tensor

from core.bench.figure import Spread
from core.looks.pruning import HALF_STEP

HALF_STEP_LINE = HALF_STEP, "half an 8-bit step"


def differences(pictures: list[Tensor], truth: list[Tensor]) -> dict[str, Spread]:
    """The largest and the root mean square difference over all pixels and channels of all pictures."""
    apart = torch.cat([(a.double() - b).flatten() for a, b in zip(pictures, truth, strict=True)])
    return {
        "max_error": Spread.exactly(float(apart.abs().max())),
        "rms_error": Spread.exactly(float(apart.square().mean().sqrt())),
    }
