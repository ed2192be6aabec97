"""Refinement: a look is fitted to the photo that it was read from, seen by that photo's own camera.

First the embedding and the tone, and the weights that embeddings give, which may take values that no embedding gives. Then the hidden
layers of the SH transfer too: places are an input of these, so they can learn where in this one photo a shadow falls. What the photo does
not show is held to the look of the first part meanwhile, or it would take on colours that nothing bears out.
"""

from collections.abc import Callable, Generator, Iterator
from math import cos, pi
from typing import Protocol, runtime_checkable

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from core.appearance.colouring import EVEN, Colouring, Weights
from core.scene.camera import Camera
from core.system.threads import threads_for_blocks

STEPS, RATE = 128, 0.1  # of Adam, as WildGaussians and nerfbaselines have them; a rate falls to zero along half a cosine
LATER_STEPS, HIDDEN_RATE = 64, 0.003  # of the second part; 128 steps at 0.001 end within 0.1 dB
BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8  # the defaults of Adam's authors
TONE_RATE = 0.02  # of the logarithms of the gains; 0.01 to 0.05 are within 0.1 dB of each other
GIVEN_RATE = 0.02  # of weights that embeddings give, in units of how widely they differ between looks: in all, no more than twice as far
HELD, HOLD = 2000, 0.05  # Gaussians that the photo does not show: as many a step looks at, and the weight of how far they move
CELLS = 40  # along the longer side: a photo is compared with its render in means over cells
CELL_PX = 9  # at most; renders twice that large take twice the time for 0.1 dB (core/TRIED.md)
MOSTLY = 0.5  # valid: a pixel of a smaller picture then is
LEAST_SKY = 0.1  # weight of a cell of sky, however little of the place there is
FARTHEST = 2.0  # times the reach of training photos; see core.appearance.reach

Seen = tuple[Camera, Float[Tensor, "h w 3"], Bool[Tensor, "h w"] | None]  # what a camera shows: the photo, and where it is valid
Course = Generator[Colouring, None, Colouring]  # the best look so far after each step, and at the end


@runtime_checkable
class Refinable(Protocol):
    """What a camera sees of a scene whose look follows a Colouring.

    has_looks: whether the view follows its Colouring at all. sky: how much of each pixel is sky, [0, 1]; None if there is none that is told from
    the place. given_spread: how widely the weights that embeddings give differ between looks. hidden: those of the SH transfer's hidden
    layers. Of either, there may be none.
    """

    has_looks: bool
    sky: Float[Tensor, "h w"] | None
    given_spread: Weights
    hidden: Weights

    def render(self, look: Colouring) -> Float[Tensor, "h w 3"]:
        """The view in this look; differentiable in all of the look that it follows."""

    def bound(self, embedding: Float[Tensor, " e"]) -> Float[Tensor, " e"]:
        """The embedding, or the nearest to it that a refinement may take."""

    def unseen(self, valid: Bool[Tensor, "h w"] | None) -> Int[Tensor, " r"]:
        """Rows of the Gaussians that the camera does not see in these pixels."""

    def harmonics(self, rows: Int[Tensor, " r"], look: Colouring) -> Float[Tensor, "r c 3"]:
        """Their SH in this look; differentiable as `render`."""


def no_finer_than_needed(camera: Camera, picture: Float[Tensor, "H W 3"], valid: Bool[Tensor, "H W"] | None) -> Seen:
    """What a look is to be refined against: the camera's photo, shrunk by area to CELLS of CELL_PX if it is larger."""
    small = camera.shrunk(CELLS * CELL_PX / max(camera.width, camera.height))
    if small.width == camera.width and small.height == camera.height:
        return camera, picture, valid

    def means(values: Float[Tensor, "H W c"]) -> Float[Tensor, "h w c"]:
        return F.interpolate(values.permute(2, 0, 1)[None], size=(small.height, small.width), mode="area")[0].permute(1, 2, 0)

    if valid is None:
        return small, means(picture), None
    share = means(valid[..., None].float())
    return small, means(picture * valid[..., None]) / share.clamp_min(1e-6), share[..., 0] >= MOSTLY


def steps_of(seen: Refinable) -> int:
    """How many steps a refinement takes."""
    return STEPS + LATER_STEPS if seen.hidden else STEPS


def refinement(seen: Refinable, start: Colouring, picture: Float[Tensor, "h w 3"], valid: Bool[Tensor, "h w"] | None = None) -> Iterator[Colouring]:
    """The best look after 0, 1, ... `steps_of(seen)` steps from `start`; none if the view has no looks.

    It minimises the mean |render - picture| of cell means: detail finer than a cell says where things lie, not how they are lit. L1,
    because passers-by would pull harder on a squared error. All sky together counts no more than the place, whose look a photo that is
    mostly sky would otherwise bend (core/TRIED.md, "Refinement"). The best-fitting step so far is kept, the start included. The result is
    the same for any number of threads, which torch's own matrix products do not ensure on every processor.
    """
    if not seen.has_looks:
        return
    weights = torch.ones(()) if seen.sky is None else _cell_weights(seen.sky, valid)
    compared = (weights * _cell_means(torch.ones_like(picture), valid)).mean()

    def misfit(look: Colouring) -> Tensor:
        return (weights * _cell_means(seen.render(look) - picture, valid).abs()).mean() / compared

    best = yield from _as_a_whole(seen, start, misfit)
    if seen.hidden:
        yield from _place_by_place(seen, best, misfit, seen.unseen(valid))


def _as_a_whole(seen: Refinable, start: Colouring, misfit: Callable[[Colouring], Tensor]) -> Course:
    """Embedding, tone and the weights that embeddings give.

    Embeddings stay within `bound`: beyond, the SH transfer makes up colours for what the photo does not show.
    """
    embedding, tone, changes = start.detached()
    gains = (EVEN.to(embedding.device) if tone is None else tone).log()
    changes = {name: torch.zeros_like(spread) for name, spread in seen.given_spread.items()} | changes
    learning = [_Learning(embedding, RATE, seen.bound), _Learning(gains, TONE_RATE)]
    learning += [_Learning(changes[name], GIVEN_RATE * spread) for name, spread in seen.given_spread.items()]
    return _descent(learning, STEPS, lambda: Colouring(embedding, gains.exp(), changes), misfit)


def _place_by_place(seen: Refinable, first: Colouring, misfit: Callable[[Colouring], Tensor], unseen: Int[Tensor, " u"]) -> Course:
    """The hidden layers, and on from `first` the weights that embeddings give, while Gaussians of `unseen` are held where `first` has them."""
    changes = {name: torch.zeros_like(weight) for name, weight in seen.hidden.items()} | first.detached().changes
    rates = {name: GIVEN_RATE * spread for name, spread in seen.given_spread.items()} | dict.fromkeys(seen.hidden, HIDDEN_RATE)
    generator = torch.Generator().manual_seed(0)

    def moved(look: Colouring) -> Tensor | float:
        if not len(unseen):
            return 0.0
        few = len(unseen) <= HELD
        rows = unseen if few else unseen[torch.randint(len(unseen), (HELD,), generator=generator).to(unseen.device)]
        with torch.no_grad():
            before = seen.harmonics(rows, first)
        return (seen.harmonics(rows, look) - before).abs().sum(dim=1).mean()

    learning = [_Learning(changes[name], rate) for name, rate in rates.items()]
    course = _descent(learning, LATER_STEPS, lambda: first._replace(changes=changes), lambda look: misfit(look) + HOLD * moved(look))
    next(course)  # `first` itself, with which the first part ended
    return (yield from course)


class _Learning:
    """Adam (Kingma & Ba 2015) for one tensor, in place. torch's own would import its compiler, which takes as long as half of a refinement.

    rate: of each number, or of all. bound: where the tensor may be.
    """

    def __init__(self, value: Tensor, rate: float | Tensor, bound: Callable[[Tensor], Tensor] | None = None):
        self.value, self.rate, self.bound, self.count = value.requires_grad_(), rate, bound, 0
        self.first, self.second = torch.zeros_like(value), torch.zeros_like(value)

    @torch.no_grad()
    def step(self, gradient: Tensor, share: float) -> None:
        """Move the value at `share` of the rate."""
        self.count += 1
        self.first.lerp_(gradient, 1 - BETA_1)
        self.second.lerp_(gradient**2, 1 - BETA_2)
        first, second = self.first / (1 - BETA_1**self.count), self.second / (1 - BETA_2**self.count)
        self.value -= share * self.rate * first / (second.sqrt() + EPSILON)
        if self.bound is not None:
            self.value.copy_(self.bound(self.value))


def _descent(learning: list[_Learning], steps: int, learned: Callable[[], Colouring], loss_of: Callable[[Colouring], Tensor]) -> Course:
    """The best look after 0, 1, ... `steps` steps; returns the last of these. learned: the look of what is learned, as it is now."""
    best, least = None, float("inf")
    for step in range(steps + 1):
        with torch.enable_grad(), threads_for_blocks():
            now = learned()
            loss = loss_of(now)
        if float(loss.detach()) < least or best is None:
            best, least = now.detached(), float(loss.detach())
        yield best
        if step == steps:
            return best
        with threads_for_blocks():
            gradients = torch.autograd.grad(loss, [one.value for one in learning], materialize_grads=True)
        for one, gradient in zip(learning, gradients):
            one.step(gradient, share=(1 + cos(pi * step / steps)) / 2)


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
