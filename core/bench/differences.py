"""How far pictures are from the true ones."""

from math import sqrt

from torch import Tensor

from core.bench.figure import Spread
from core.looks.pruning import HALF_STEP

HALF_STEP_LINE = HALF_STEP, "half an 8-bit step"


def differences(pictures: list[Tensor], truth: list[Tensor]) -> dict[str, Spread]:
    """The largest and the root mean square difference over all pixels and channels of all pictures."""
    largest, squares, numbers = 0.0, 0.0, 0
    for picture, true in zip(pictures, truth, strict=True):
        apart = picture.double() - true
        largest = max(largest, float(apart.abs().max()))
        squares += float(apart.square().sum())
        numbers += apart.numel()
    return {"max_error": Spread.exactly(largest), "rms_error": Spread.exactly(sqrt(squares / numbers))}
