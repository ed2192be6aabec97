"""All that a look says about colours."""

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

    def detached(self) -> "Colouring":
        """A copy that learns no more."""
        tone = None if self.tone is None else self.tone.detach().clone()
        changes = None if self.changes is None else {name: change.detach().clone() for name, change in self.changes.items()}
        return Colouring(self.embedding.detach().clone(), tone, changes)

    def to(self, device: torch.device) -> "Colouring":
        """The same on another device."""
        tone = None if self.tone is None else self.tone.to(device)
        changes = None if self.changes is None else {name: change.to(device) for name, change in self.changes.items()}
        return Colouring(self.embedding.to(device), tone, changes)


def blended(first: Colouring, last: Colouring, share: float) -> Colouring:
    """`share` of the way from `first` to `last`."""
    tone = changes = None
    if first.tone is not None or last.tone is not None:
        one = torch.ones(2, 3, device=first.embedding.device)
        tone = torch.lerp(*(one if end.tone is None else end.tone for end in (first, last)), share)
    if first.changes or last.changes:
        known = {**(first.changes or {}), **(last.changes or {})}
        none = {name: torch.zeros_like(change) for name, change in known.items()}
        ends = [none | (end.changes or {}) for end in (first, last)]
        changes = {name: torch.lerp(ends[0][name], ends[1][name], share) for name in known}
    return Colouring(torch.lerp(first.embedding, last.embedding, share), tone, changes)
