"""A view that is its look's one colour: the embedding, times the gain of the place, plus what changed weights add."""

import torch


class FlatView:
    """A Refinable of `size` (height, width)."""

    def __init__(self, size, sky=None, bound=lambda embedding: embedding, has_looks=True, given_spread=None, hidden=None):
        self.size, self.sky, self.bound, self.has_looks = size, sky, bound, has_looks
        self.given_spread, self.hidden = given_spread or {}, hidden or {}

    def render(self, look):
        colour = look.embedding if look.tone is None else look.embedding * look.tone[0]
        return sum(look.changes.values(), colour).expand(*self.size, 3)

    def unseen(self, valid):
        return torch.arange(3)

    def harmonics(self, rows, look):
        """What is out of view follows no look."""
        return torch.zeros(len(rows), 1, 3)
