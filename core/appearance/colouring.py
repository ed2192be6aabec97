"""All that a look says about colours."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

# A tensor for some parameters of the SH transfer, by their names in it: their values, changes or spreads.
Weights = dict[str, Tensor]
UNCHANGED: Weights = {}
EVEN = torch.ones(2, 3)  # the tone that changes nothing: gains of 1


class Colouring(NamedTuple):
    """What turns base coefficients into those of a look: its embedding, and what no embedding can express.

    tone: gains of place and sky (core.appearance.tone), for a photo in a light that no training photo has, or of a
    refinement. changes: what a refinement added to weights of the SH transfer.
    """

    embedding: Float[Tensor, " e"]
    tone: Float[Tensor, "2 3"] | None = None
    changes: Weights = UNCHANGED

    @property
    def gains(self) -> Float[Tensor, "2 3"]:
        """The tone; EVEN without one."""
        return EVEN.to(self.embedding.device) if self.tone is None else self.tone

    def map(self, function: Callable[[Tensor], Tensor]) -> "Colouring":
        """`function` applied to every tensor."""
        tone = None if self.tone is None else function(self.tone)
        return Colouring(
            function(self.embedding), tone, {name: function(change) for name, change in self.changes.items()}
        )

    def detached(self) -> "Colouring":
        """A copy that learns no more."""
        return self.map(lambda tensor: tensor.detach().clone())

    def to(self, device: torch.device) -> "Colouring":
        """The same on another device."""
        return self.map(lambda tensor: tensor.to(device))


def blended(first: Colouring, last: Colouring, share: float) -> Colouring:
    """`share` of the way from `first` to `last`."""
    tone = None
    if first.tone is not None or last.tone is not None:
        tone = torch.lerp(first.gains, last.gains, share)
    none = {name: torch.zeros_like(change) for name, change in (first.changes | last.changes).items()}
    begin, aim = none | first.changes, none | last.changes
    changes = {name: torch.lerp(begin[name], aim[name], share) for name in none}
    return Colouring(torch.lerp(first.embedding, last.embedding, share), tone, changes)
