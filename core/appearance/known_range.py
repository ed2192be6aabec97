"""The known range: the ellipsoid of the training photos' embeddings, which are all that the SH transfer was trained on.

Beyond it the SH transfer makes up colours: the embedding of a night photo, for a run on eight photos of daylight, lay
six times as far out, and turned a white church green. The limit changes the figures of held-out photos by no more than
0.02 dB (plaza, Liberty).
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from core.system.threads import one_torch_thread

WEAK_AXIS = 0.3  # of the longest: an unseen photo may differ a little in what training photos share


@dataclass(frozen=True)
class KnownRange:
    """The ellipsoid around the mean of the training photos' embeddings
    that passes through the farthest of them, float64.

    axes: the principal ones, as rows. lengths: their ratio, weak ones lengthened. size: what all lengths are multiplied
    by.
    """

    centre: Float[Tensor, " e"]
    axes: Float[Tensor, "a e"]
    lengths: Float[Tensor, " a"]
    size: Float[Tensor, ""]

    @staticmethod
    @torch.no_grad()
    def of(met: Float[Tensor, "k e"]) -> "KnownRange":
        """The known range of these embeddings; without any, everything is within it."""
        met = met.double()
        if not len(met):
            return KnownRange(
                met.new_zeros(met.shape[1]), met.new_zeros(0, met.shape[1]), met.new_zeros(0), met.new_ones(())
            )
        centre = met.mean(dim=0)
        away = met - centre
        with one_torch_thread():  # more would round differently
            # All axes are needed where photos are fewer; else that would make a matrix of photos times photos.
            _, strengths, axes = torch.linalg.svd(away, full_matrices=len(met) < met.shape[1])
        lengths = strengths.new_zeros(len(axes))
        lengths[: len(strengths)] = strengths
        lengths = lengths.clamp_min(max(WEAK_AXIS * float(strengths[0]), 1e-12))  # a single photo has none
        return KnownRange(centre, axes, lengths, ((away @ axes.T) / lengths).norm(dim=-1).max().clamp_min(1e-12))

    @torch.no_grad()
    def distance(self, embedding: Float[Tensor, " e"]) -> float:
        """Its distance from the mean; the farthest of the training photos lies at 1."""
        along = (embedding.double() - self.centre) @ self.axes.T
        # Rounded, so that the farthest lies at 1 exactly.
        return float(((along / self.lengths).norm() / self.size).float())

    @torch.no_grad()
    def nearest(self, embedding: Float[Tensor, " e"], farthest: float = 1.0) -> Float[Tensor, " e"]:
        """The embedding, moved toward the mean until its distance is no more than `farthest`;
        one that is nearer stays as it is."""
        distance = self.distance(embedding)
        if distance <= farthest:
            return embedding
        return (self.centre + (embedding.double() - self.centre) * (farthest / distance)).to(embedding.dtype)
