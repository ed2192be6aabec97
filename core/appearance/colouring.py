"""All that a look says about colours."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

Weights = dict[str, Tensor]  # of the SH transfer, by their names in it


class Colouring(NamedTuple):
    """tone: gains of place and sky (core.appearance.tone). changes: what is added to weights of the SH transfer, by which a look refined against
    a photo goes beyond all that embeddings express. Without either, a look is its embedding's."""

    embedding: Float[Tensor, " e"]
    tone: Float[Tensor, "2 3"] | None = None
    changes: Weights | None = None

    def map(self, function: Callable[[Tensor], Tensor]) -> "Colouring":
        """`function` applied to every tensor."""
        tone = None if self.tone is None else function(self.tone)
        changes = None if self.changes is None else {name: function(change) for name, change in self.changes.items()}
        return Colouring(function(self.embedding), tone, changes)

    def detached(self) -> "Colouring":
        """A copy that learns no more."""
        return self.map(lambda tensor: tensor.detach().clone())

    def to(self, device: torch.device) -> "Colouring":
        """The same on another device."""
        return self.map(lambda tensor: tensor.to(device))


def blended(first: Colouring, last: Colouring, share: float) -> Colouring:
    """`share` of the way from `first` to `last`."""
    tone = changes = None
    if first.tone is not None or last.tone is not None:
        one = torch.ones(2, 3, device=first.embedding.device)
        tone = torch.lerp(*(one if end.tone is None else end.tone for end in (first, last)), share)
    if first.changes or last.changes:
        none = {name: torch.zeros_like(change) for end in (first, last) for name, change in (end.changes or {}).items()}
        begin, aim = (none | (end.changes or {}) for end in (first, last))
        changes = {name: torch.lerp(begin[name], aim[name], share) for name in none}
    return Colouring(torch.lerp(first.embedding, last.embedding, share), tone, changes)
