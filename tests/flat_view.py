"""A view that is its look's one colour: the embedding, times the gain of the place, plus what changed weights add."""

import torch


class FlatView:
    """A Refinable of `size` (height, width). follows: whether the picture follows its look at all."""

    def __init__(self, size, sky=None, bound=lambda embedding: embedding, follows=True, given_spread=None, hidden_weights=None):
        self.size, self.sky, self.bound, self.follows = size, sky, bound, follows
        self.given_spread, self.hidden_weights = given_spread or {}, hidden_weights or {}

    def render(self, look):
        colour = look.embedding if look.tone is None else look.embedding * look.tone[0]
        colour = sum((look.changes or {}).values(), colour)
        return (colour if self.follows else colour.detach()).expand(*self.size, 3)

    def unseen(self, valid):
        return torch.arange(3)

    def harmonics(self, rows, look):
        """What is out of view follows no look."""
        return torch.zeros(len(rows), 1, 3)
