"""A view that is its look's one colour: the embedding, times the gain of the place, plus what changed weights add."""

import torch

from core.scene.cells import cell_sums


class FlatView:
    """A Refinable of `size` (height, width)."""

    def __init__(self, size, bound=lambda embedding: embedding, given_spread=None, hidden=None):
        self.size, self.bound = size, bound
        self.given_spread, self.hidden_weights = given_spread or {}, hidden or {}

    def render(self, look):
        colour = look.embedding if look.tone is None else look.embedding * look.tone[0]
        return sum(look.changes.values(), colour).expand(*self.size, 3)

    def in_cells(self, weight):
        assert weight.shape == self.size
        return FlatInCells(self, weight)

    def harmonics(self, rows, look):
        """What is out of view follows no look."""
        return torch.zeros(len(rows), 1, 3)


class FlatInCells:
    """An InCells without sky."""

    sky, unseen = None, torch.arange(3)

    def __init__(self, view, weight):
        self.view, self.weight = view, weight[..., None]

    def sums(self, look):
        return cell_sums(self.view.render(look) * self.weight)
