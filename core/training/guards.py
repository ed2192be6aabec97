"""Which steps are not taken: those whose loss or gradient is not finite, or whose loss is far beyond what is usual.

Adam divides by the size of past gradients. One that is NaN spoils the parameters for good; one that is a thousand times
too large stops them from learning for a thousand steps.
"""

import math
from collections.abc import Iterable
from statistics import median

import torch
from torch import Tensor

SPIKE = 10.0  # times the usual picture loss
# No photo alone costs that much: L1 and SSIM against a render in [0, 1] stay below 1.6, exposure jitter included. So an
# odd photo (black, white, of another place) is never taken for a spike; the render has left the range.
LEAST_SPIKE = 2.0
ALL_GONE = (
    "The last Gaussians were removed as faint, large, far from the points or of no use; only the sky is left, if any. "
    "Look at the scene with `wegs doctor`, and at the settings prune_opacity, largest_scale and reach."
)


def fault_of_loss(total: float, picture_loss: float, photo: int, last_losses: list[float | None]) -> str | None:
    """Why a step with these losses is not to be taken, in words that follow "its"; None if it is.

    last_losses: the picture loss of each photo when it was last trained on, None where it was not yet. Usual is the
    photo's own or, if larger, the median of all.
    """
    if not math.isfinite(total):
        return "loss was not finite"
    known = [loss for loss in last_losses if loss is not None]
    usual = max(median(known), last_losses[photo] or 0.0) if known else math.inf
    if picture_loss > max(SPIKE * usual, LEAST_SPIKE):
        return f"picture loss of {picture_loss:.3g} was a spike; usual is {usual:.3g}"
    return None


def finite(tensors: Iterable[Tensor | None]) -> bool:
    """Whether no number in these tensors is NaN or infinite (nor their sums: that takes a third of the time)."""
    sums = [tensor.sum() for tensor in tensors if tensor is not None]
    return not sums or bool(torch.isfinite(torch.stack(sums)).all())  # asked once: a GPU has to be waited for
