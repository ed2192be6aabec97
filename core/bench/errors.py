"""How far pictures are from those that they should be."""

import torch
from torch import Tensor

from core.bench.figure import Spread
from core.looks.pruning import HALF_STEP

LIMIT = HALF_STEP, "half an 8-bit step"


def errors(pictures: list[Tensor], truth: list[Tensor]) -> dict[str, Spread]:
    """The largest and the root mean square difference over all pixels and channels of all pictures."""
    differences = torch.cat([(a.double() - b).flatten() for a, b in zip(pictures, truth, strict=True)])
    return {
        "max_error": Spread.exactly(float(differences.abs().max())),
        "rms_error": Spread.exactly(float(differences.square().mean().sqrt())),
    }
