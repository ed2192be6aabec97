"""A view that is its look's one colour: the embedding, times the gain of the place, plus what changed weights add."""

import torch


class FlatView:
    """A Refinable of `size` (height, width). follows: whether the picture follows its look at all."""

    def __init__(self, size, sky=None, bound=lambda embedding: embedding, follows=True, weights_apart=None, weights_shared=None):
        self.size, self.sky, self.bound, self.follows = size, sky, bound, follows
        self.weights_apart, self.weights_shared = weights_apart or {}, weights_shared or {}
        self.looks = []

    def render(self, look):
        self.looks.append(look.kept())
        colour = look.embedding if look.tone is None else look.embedding * look.tone[0]
        colour = sum((look.changes or {}).values(), colour)
        return (colour if self.follows else colour.detach()).expand(*self.size, 3)

    def unseen(self, most, generator):
        return torch.arange(most)

    def harmonics(self, rows, look):
        """What is out of view follows no look."""
        return torch.zeros(len(rows), 1, 3)
