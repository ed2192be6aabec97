"""Refinement: a look is fitted to the photo that it was read from, seen by that photo's own camera."""

from collections.abc import Callable, Iterator
from math import cos, pi
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from core.system.threads import threads_for_blocks

STEPS, RATE = 128, 0.1  # of Adam, as WildGaussians and nerfbaselines have them; the rate falls to zero along half a cosine
BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8  # the defaults of Adam's authors
TONE_RATE = 0.02  # of the logarithms of the gains; 0.01 to 0.05 are within 0.1 dB of each other
CELLS = 40  # along the longer side: a photo is compared with its render in means over cells
LEAST_SKY = 0.1  # weight of a cell of sky, however little of the place there is
FARTHEST = 2.0  # times the reach of training photos; see core.appearance.reach


class Refined(NamedTuple):
    """A look: embedding and tone (core.appearance.tone)."""

    embedding: Float[Tensor, " e"]
    tone: Float[Tensor, "2 3"]


Render = Callable[[Float[Tensor, " e"], Float[Tensor, "2 3"] | None], Float[Tensor, "h w 3"]]  # of embedding and tone
Bound = Callable[[Float[Tensor, " e"]], Float[Tensor, " e"]]


def refinement(
    render: Render,
    bound: Bound,
    start: Float[Tensor, " e"],
    picture: Float[Tensor, "h w 3"],
    valid: Bool[Tensor, "h w"] | None = None,
    tone: Float[Tensor, "2 3"] | None = None,
    sky: Float[Tensor, "h w"] | None = None,
) -> Iterator[Refined]:
    """The best look after 0, 1, ... STEPS of Adam on embedding and tone, which begin as given; none if looks follow no embedding.

    It minimises the mean |render - picture| of cell means: detail finer than a cell says where things lie, not how they are lit. L1,
    because passers-by would pull harder on a squared error. sky: how much of each pixel is sky; all of it together counts no more than the
    place, whose look a photo that is mostly sky would otherwise bend (core/TRIED.md, "Refinement"). The best-fitting step so far is kept,
    the start included. bound: keeps an embedding where it may go; beyond, the SH transfer makes up colours for what the photo does not
    show. The result is the same for any number of threads, which torch's own matrix products do not ensure on every processor.
    """
    embedding = start.detach().clone().requires_grad_()
    gains = (torch.ones(2, 3, device=start.device) if tone is None else tone).log().requires_grad_()
    with torch.enable_grad(), threads_for_blocks():
        if not render(embedding, torch.ones_like(gains)).requires_grad:
            return
    learning = _Learning(embedding, RATE), _Learning(gains, TONE_RATE)
    weights = 1.0 if sky is None else _cell_weights(sky, valid)
    best, least = None, float("inf")
    for step in range(STEPS + 1):
        with torch.enable_grad(), threads_for_blocks():
            loss = (weights * _cell_means(render(embedding, gains.exp()) - picture, valid).abs()).mean()
            gradients = torch.autograd.grad(loss, (embedding, gains), materialize_grads=True)
        if float(loss.detach()) < least or best is None:
            best, least = Refined(embedding.detach().clone(), gains.detach().exp()), float(loss.detach())
        yield best
        with torch.no_grad():
            for one, gradient in zip(learning, gradients):
                one.step(gradient, share=(1 + cos(pi * step / STEPS)) / 2)
            embedding.copy_(bound(embedding))


class _Learning:
    """Adam (Kingma & Ba 2015) for one tensor. torch's own would import its compiler, which takes as long as half of a refinement."""

    def __init__(self, value: Tensor, rate: float):
        self.value, self.rate, self.count = value, rate, 0
        self.first, self.second = torch.zeros_like(value), torch.zeros_like(value)

    def step(self, gradient: Tensor, share: float) -> None:
        """Move the value, in place, at `share` of the rate."""
        self.count += 1
        self.first.lerp_(gradient, 1 - BETA_1)
        self.second.lerp_(gradient**2, 1 - BETA_2)
        first, second = self.first / (1 - BETA_1**self.count), self.second / (1 - BETA_2**self.count)
        self.value -= share * self.rate * first / (second.sqrt() + EPSILON)


def _cell_weights(sky: Float[Tensor, "h w"], valid: Bool[Tensor, "h w"] | None) -> Float[Tensor, "1 1 rows columns"]:
    """1, and less for cells of sky where these would outweigh the others."""
    sky, place = (_cell_means(part[..., None], valid) for part in (sky, 1 - sky))
    weight = (place.sum() / sky.sum().clamp_min(1e-6)).clamp(LEAST_SKY, 1.0)
    return 1 - (1 - weight) * sky / (sky + place).clamp_min(1e-6)


def _cell_means(picture: Float[Tensor, "h w c"], valid: Bool[Tensor, "h w"] | None) -> Float[Tensor, "1 c rows columns"]:
    if valid is not None:
        picture = picture * valid[..., None]
    height, width = picture.shape[:2]
    size = max(height, width)
    cells = tuple(max(1, round(CELLS * side / size)) if size > CELLS else side for side in (height, width))
    return F.adaptive_avg_pool2d(picture.permute(2, 0, 1)[None], cells)
