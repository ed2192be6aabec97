"""Which steps are invalid, and therefore not taken:
those whose loss or gradient is not finite, or whose loss is far above the usual.

Adam divides by the size of past gradients. A NaN among them spoils the parameters for good; a gradient that is a
thousand times too large stops them from learning for a thousand steps.
"""

import math
from bisect import bisect_left, insort
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

SPIKE = 10.0  # times the usual picture loss
# No photo alone costs that much: against a render in [0, 1] the picture loss stays below 1.6, exposure jitter included.
# So an odd photo (black, white, of another place) is never taken for a spike; above this, the render has left [0, 1].
LEAST_SPIKE = 2.0


class LastLosses:
    """The picture losses of the photos, and the usual one.

    by_photo: of each photo when it was last trained on, None where it was not yet. Their order is kept from step to
    step: sorting those of 2,600 photos anew takes 0.3 ms, a tenth of a step on a GPU.
    """

    def __init__(self, by_photo: list[float | None]):
        self.by_photo = by_photo
        self._ascending = sorted(loss for loss in by_photo if loss is not None)

    def replace(self, index: int, loss: float) -> None:
        """Let a photo have this loss, also in `by_photo`."""
        if (before := self.by_photo[index]) is not None:
            del self._ascending[bisect_left(self._ascending, before)]
        insort(self._ascending, loss)
        self.by_photo[index] = loss

    @property
    def usual(self) -> float:
        """The median; infinity if none is known."""
        middle, is_odd = divmod(len(self._ascending), 2)
        if not self._ascending:
            return math.inf
        return self._ascending[middle] if is_odd else (self._ascending[middle - 1] + self._ascending[middle]) / 2


def largest_loss(usual: float) -> float:
    """The largest picture loss of a valid step. usual: see `LastLosses`."""
    return max(SPIKE * usual, LEAST_SPIKE)


def sound(total: Float[Tensor, ""], picture_loss: Float[Tensor, ""], largest: Float[Tensor, ""]) -> Bool[Tensor, ""]:
    """Whether these losses are those of a valid step. total: all losses together. largest: see `largest_loss`."""
    return (total.abs() < math.inf) & (picture_loss <= largest)


class StepFacts(NamedTuple):
    """The outcome of a step, as it was read back from the device that computed it.

    loss: what the step minimised. residual_size: mean absolute residual of the SH. shown_share: mean of the photo's
    mask, 0 without one. sound: whether the losses are valid. taken: whether the gradients of the Gaussians, the
    embedding and the SH transfer are finite as well; then the Gaussians are updated. learned: whether those of all
    other weights are finite as well; then the networks are updated.
    """

    loss: float
    picture_loss: float
    residual_size: float
    shown_share: float
    sound: bool
    taken: bool
    learned: bool

    @staticmethod
    def of(numbers: Sequence[float]) -> "StepFacts":
        """From what a step read back: the fields in their order, 1 for True and 0 for False."""
        loss, picture_loss, residual_size, shown_share, sound, taken, learned = numbers
        return StepFacts(loss, picture_loss, residual_size, shown_share, bool(sound), bool(taken), bool(learned))


def fault(facts: StepFacts, usual: float) -> str | None:
    """What was wrong with a step, in words that follow "its"; None if it was valid."""
    if not facts.sound and not math.isfinite(facts.loss):
        return "loss was not finite"
    if not facts.sound:
        return f"picture loss of {facts.picture_loss:.3g} was a spike; usual is {usual:.3g}"
    if not facts.taken:
        return "gradient was not finite"
    return None if facts.learned else "networks' gradient was not finite"


def finite(tensors: Iterable[Tensor | None], where: torch.device) -> Bool[Tensor, ""]:
    """Whether all numbers in these tensors, all on the device `where`, are finite.
    On a CPU, a tensor whose sum overflows is not."""
    given = [tensor for tensor in tensors if tensor is not None and tensor.numel()]
    if not given:
        return torch.ones((), dtype=torch.bool, device=where)
    if where.type != "cpu":
        return _finite_at_once(given)
    # A sum is NaN or infinite where a number is, and takes a third of the time of comparing each.
    return torch.stack([tensor.sum() for tensor in given]).abs().amax() < math.inf


def _finite_at_once(tensors: list[Tensor]) -> Bool[Tensor, ""]:
    """As `finite`, in one kernel for all: that of torch's GradScaler, with a scale of 1."""
    found = tensors[0].new_zeros(())
    torch._amp_foreach_non_finite_check_and_unscale_(tensors, found, torch.ones_like(found))
    return found == 0


def known_invalid(valid: Bool[Tensor, ""]) -> bool:
    """Whether the host knows that a step is not valid.
    Never on a GPU, which it does not wait for: there the kernels skip an invalid step."""
    return valid.device.type == "cpu" and not valid
