"""Refinement: a look is fitted to the photo that it was read from, seen by that photo's own camera.

First the tone and the weights that the embedding gives, which may take values that no embedding gives; where embeddings
give no weights, the embedding itself. Then the hidden layers of the SH transfer too: places are an input of these, so
they can learn where in this one photo a shadow falls. What the photo does not show is held to the look of the first
part meanwhile, or it would take on colours that nothing bears out.
"""

from collections import deque
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, replace
from itertools import cycle
from math import cos, pi
from typing import Protocol, runtime_checkable

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from core.appearance.colouring import Colouring, Weights
from core.appearance.strangeness import LARGEST_EXCESS, excess
from core.report import OnProgress, ignore_progress
from core.scene.camera import Camera
from core.scene.cells import cell_of_pixels, cell_sums, grid
from core.system.threads import threads_for_blocks

# Of Adam, as WildGaussians and nerfbaselines have them; a rate falls to zero along half a cosine.
STEPS, RATE = 128, 0.1
LATER_STEPS, HIDDEN_RATE = 64, 0.003  # of the second part; 128 steps at 0.001 end within 0.1 dB
BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8  # the defaults of Adam's authors
TONE_RATE = 0.02  # of the logarithms of the gains; 0.01 to 0.05 are within 0.1 dB of each other
# Of weights that embeddings give, in units of how widely these differ between looks: all steps move one by no more than
# two.
GIVEN_RATE = 0.02
# Of Gaussians that the photo does not show: how many a step samples, and the weight of how far their SH move.
HELD, HOLD = 2000, 0.05
UNSEEN_PX = 1.0  # a Gaussian that makes up less of a photo is not shown by it
# The longer side of a photo that looks are compared with: finer cells say where things lie, not how they are lit.
LONGER_SIDE_PX = 640
LEAST_SKY = 0.1  # weight of a cell of sky, however little of the place there is
FARTHEST = 2.0  # times as far out as the known range ends; see core.appearance.known_range

Course = Generator[Colouring, None, Colouring]  # the best look so far after each step, and at the end


@runtime_checkable
class Refinable(Protocol):
    """What a camera sees of a scene whose look follows a Colouring.

    given_spread: the standard deviation, between looks, of the output layer that embeddings give; empty where an
    embedding is an input instead. hidden_weights: of the hidden layers; empty for a transfer that has none.
    """

    given_spread: Weights
    hidden_weights: Weights

    def render(self, look: Colouring) -> Float[Tensor, "h w 3"]:
        """The view in this look."""

    def in_cells(self, weight: Float[Tensor, "h w"]) -> "InCells":
        """The view in cells, its pixels counting as much as these weigh."""

    def bound(self, embedding: Float[Tensor, " e"]) -> Float[Tensor, " e"]:
        """The embedding, or the nearest to it that a refinement may take."""

    def harmonics(self, rows: Int[Tensor, " r"], look: Colouring) -> Float[Tensor, "r c 3"]:
        """The SH of these Gaussians in this look, before tone and sky;
        differentiable by whatever of the look they depend on."""


@runtime_checkable
class InCells(Protocol):
    """A view in cells (core.scene.cells)."""

    @property
    def sky(self) -> Float[Tensor, " cells"] | None:
        """How much of each cell is sky, px; None if there is none that is told from the place."""

    @property
    def unseen(self) -> Int[Tensor, " u"]:
        """Rows of the Gaussians of which it shows less than UNSEEN_PX:
        what lies out of view, behind something, or where nothing counts."""

    def sums(self, look: Colouring) -> Float[Tensor, "cells 3"]:
        """The sums of the pixels of each cell in this look; differentiable by whatever of the look they depend on."""


@dataclass(frozen=True)
class RefinementTarget:
    """What a photo shows, against which a look is refined. picture: as `camera` sees it, [0, 1].
    weight: how much each pixel counts, [0, 1]."""

    camera: Camera
    picture: Float[Tensor, "h w 3"]
    weight: Float[Tensor, "h w"]

    @staticmethod
    def of(camera: Camera, picture: Float[Tensor, "H W 3"], valid: Bool[Tensor, "H W"] | None) -> "RefinementTarget":
        """The photo, shrunk by area to LONGER_SIDE_PX if it is larger. valid: what of it counts; all, if None."""
        weight = torch.ones_like(picture[..., 0]) if valid is None else valid.float()
        if max(camera.width, camera.height) <= LONGER_SIDE_PX:
            return RefinementTarget(camera, picture, weight)
        small = camera.within(LONGER_SIDE_PX)

        def means(values: Float[Tensor, "H W c"]) -> Float[Tensor, "h w c"]:
            planes = values.permute(2, 0, 1)[None]
            return F.interpolate(planes, size=(small.height, small.width), mode="area")[0].permute(1, 2, 0)

        share = means(weight[..., None])
        return RefinementTarget(small, means(picture * weight[..., None]) / share.clamp_min(1e-6), share[..., 0])

    def cell_sums(self) -> tuple[Float[Tensor, " cells"], Float[Tensor, "cells 3"]]:
        """Of each cell, how many of its pixels count, and the sum of what these show."""
        weight = self.weight[..., None]
        return cell_sums(weight)[:, 0], cell_sums(self.picture * weight)


def refinement_steps(
    seen_by: Callable[[Camera], Refinable],
    start: Colouring,
    camera: Camera,
    pixels: Float[Tensor, "h w 3"],
    valid: Bool[Tensor, "h w"] | None,
    on_progress: OnProgress = ignore_progress,
) -> Iterator[Colouring]:
    """The steps of `refinement` from the look `start` to one in which `camera` sees what a photo shows.

    pixels: the photo, [0, 1]. valid: which pixels count; None: all. on_progress: called after each step.
    """
    photo = RefinementTarget.of(camera, pixels, valid)
    seen = seen_by(photo.camera)
    steps = STEPS + LATER_STEPS if seen.hidden_weights else STEPS
    for step, look in enumerate(refinement(seen, start, photo)):
        on_progress(step, steps)
        yield look


def last(course: Iterator[Colouring]) -> Colouring:
    """The look with which a refinement ends."""
    return deque(course, maxlen=1).pop()


def refinement(seen: Refinable, start: Colouring, photo: RefinementTarget) -> Iterator[Colouring]:
    """The best look after 0, 1, ... steps from `start`. photo: of the camera that sees the view.

    It minimises the mean |render - photo| of cells: detail finer than a cell says where things lie, not how they are
    lit. L1, because passers-by would pull harder on a squared error; what looks strange in `start` counts less. All sky
    together counts no more than the place, whose look a photo that is mostly sky would otherwise bend (core/TRIED.md,
    "Refinement"). The best-fitting step so far is kept, the start included. The result is the same for any number of
    threads, which torch's own matrix products do not ensure on every processor.
    """
    photo = without_strangers(seen, start, photo)
    cells, (counted, wanted) = seen.in_cells(photo.weight), photo.cell_sums()
    share = torch.ones_like(counted) if cells.sky is None else _share_of_cells(cells.sky, counted)
    compared = 3 * (share * counted).sum()

    def misfit(look: Colouring) -> Tensor:
        return (share[:, None] * (cells.sums(look) - wanted).abs()).sum() / compared

    best = yield from _fit_output_layer(seen, start, misfit)
    if seen.hidden_weights:
        yield from _fit_hidden_layers(seen, best, misfit, cells.unseen)


@torch.no_grad()
def without_strangers(seen: Refinable, look: Colouring, photo: RefinementTarget) -> RefinementTarget:
    """The photo with lower weights, down to 0, where it looks strange in this look:
    passers-by would otherwise be painted onto the place."""
    counted, sums = photo.cell_sums()
    with threads_for_blocks():
        both = seen.in_cells(photo.weight).sums(look), sums
        shown, wanted = (
            (each / counted[:, None].clamp_min(1e-6)).T.reshape(3, *grid(*photo.weight.shape)) for each in both
        )
        static = 1 - excess(shown, wanted) / LARGEST_EXCESS
    return replace(photo, weight=photo.weight * static.flatten()[cell_of_pixels(photo.weight)])


def _fit_output_layer(seen: Refinable, start: Colouring, misfit: Callable[[Colouring], Tensor]) -> Course:
    """The first part: learn the tone and the weights that the embedding gives or, where it gives none, the embedding.

    The embedding stays within `bound`: beyond, the SH transfer makes up colours for what the photo does not show. One
    that gives weights stays as it is: refined beside them it fits the photo no better, and changes more of what other
    cameras see (core/TRIED.md, "Refinement").
    """
    start = start.detached()
    embedding, gains = start.embedding, start.gains.log()
    changes = {name: torch.zeros_like(spread) for name, spread in seen.given_spread.items()} | start.changes
    learning = [_Learning(gains, TONE_RATE)]
    learning += [_Learning(changes[name], GIVEN_RATE * spread) for name, spread in seen.given_spread.items()]
    if not seen.given_spread:
        learning.append(_Learning(embedding, RATE, seen.bound))
    return _descent(learning, STEPS, lambda: Colouring(embedding, gains.exp(), changes), misfit)


def _fit_hidden_layers(
    seen: Refinable, first: Colouring, misfit: Callable[[Colouring], Tensor], unseen: Int[Tensor, " u"]
) -> Course:
    """The second part: learn the hidden layers, and further the weights that embeddings give;
    `unseen` Gaussians are held at the look `first`."""
    changes = {
        name: torch.zeros_like(weight) for name, weight in seen.hidden_weights.items()
    } | first.detached().changes
    rates = {name: GIVEN_RATE * spread for name, spread in seen.given_spread.items()} | dict.fromkeys(
        seen.hidden_weights, HIDDEN_RATE
    )
    held = _samples(unseen, LATER_STEPS + 1)
    with torch.no_grad():
        before = seen.harmonics(held.flatten(), first).unflatten(0, held.shape)
    samples = cycle(zip(held, before, strict=True))

    def moved(look: Colouring) -> Tensor | float:
        rows, harmonics = next(samples)
        return (seen.harmonics(rows, look) - harmonics).abs().sum(dim=1).mean() if len(rows) else 0.0

    learning = [_Learning(changes[name], rate) for name, rate in rates.items()]
    course = _descent(
        learning, LATER_STEPS, lambda: first._replace(changes=changes), lambda look: misfit(look) + HOLD * moved(look)
    )
    next(course)  # `first` itself, with which the first part ended
    return (yield from course)


def _samples(rows: Int[Tensor, " r"], count: int) -> Int[Tensor, "k s"]:
    """So many samples of HELD of the rows; one of all if there are no more."""
    if len(rows) <= HELD:
        return rows[None]
    generator = torch.Generator().manual_seed(0)
    return rows[torch.randint(len(rows), (count, HELD), generator=generator).to(rows.device)]


class _Learning:
    """Adam (Kingma & Ba 2015) for one tensor, in place, with a rate for each number, which torch's own does not have.

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


def _descent(
    learning: list[_Learning], steps: int, learned: Callable[[], Colouring], loss_of: Callable[[Colouring], Tensor]
) -> Course:
    """The best look after 0, 1, ... `steps` steps; returns the last of these.
    learned: the look of what is learned, as it is now."""
    best, least = learned().detached(), float("inf")
    for step in range(steps + 1):
        with torch.enable_grad(), threads_for_blocks():
            now = learned()
            loss = loss_of(now)
        value = float(loss.detach())
        if value < least:
            best, least = now.detached(), value
        yield best
        if step < steps:
            with threads_for_blocks():
                gradients = torch.autograd.grad(loss, [one.value for one in learning], materialize_grads=True)
            for one, gradient in zip(learning, gradients):
                one.step(gradient, share=(1 + cos(pi * step / steps)) / 2)
    return best


def _share_of_cells(sky: Float[Tensor, " cells"], counted: Float[Tensor, " cells"]) -> Float[Tensor, " cells"]:
    """The weight of each cell's pixels: 1, but less for sky where all sky together would outweigh the place. sky,
    counted: how many of each cell's pixels are sky, and how many count."""
    place = (counted - sky).clamp_min(0)
    weight = (place.sum() / sky.sum().clamp_min(1e-6)).clamp(LEAST_SKY, 1.0)
    return 1 - (1 - weight) * sky / (sky + place).clamp_min(1e-6)
