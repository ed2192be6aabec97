"""Prunes a baked look: Gaussians and SH bands that no training view would miss are left out. The sky stays whole."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Bool
from torch import Tensor

from core.looks.trained import TrainedRun
from core.rasterizer import BLACK, Colour, Rasterizer
from core.rasterizer.importance import largest_contributions
from core.report import OnProgress, Report, ignore_progress
from core.scene.camera import Camera
from core.scene.splats import Splats

HALF_STEP = 0.5 / 255  # a change by at most this much hardly shows in an 8-bit picture


@dataclass(frozen=True)
class Pruned:
    """A pruned look. gaussians, bands: how many were left out.
    largest: change of any pixel in any view, in 8-bit steps."""

    splats: Splats
    gaussians: int = 0
    bands: int = 0
    largest: float = 0.0


class Pruner:
    """Prunes the looks of one scene, which share its geometry.

    Which Gaussians are left out depends on the geometry alone, so that all looks keep the same ones in the same order:
    viewers can fade between them, and a fade begins and ends with the two bakes bit for bit. Which bands are left out
    depends on the look.

    sky_count: how many of the last Gaussians are the dome. All of it is kept: in a viewer, people may look where no
    photo does, and would see holes. background: what looks are shown and compared over.
    kept: (N,) Gaussians that stay in every look; only a look so bright that they would break the bound keeps all of
    `drawn`. drawn: (N,) Gaussians that reach any pixel of any view, the dome, and those that are not finite, which the
    file's writer counts.
    """

    def __init__(
        self,
        splats: Splats,
        cameras: Sequence[Camera],
        rasterizer: Rasterizer,
        sky_count: int = 0,
        background: Colour = BLACK,
        on_progress: OnProgress = ignore_progress,
    ):
        self.cameras, self.rasterizer, self.background = cameras, rasterizer, background
        always_kept = ~splats.finite_rows()
        always_kept[len(splats) - sky_count :] = True
        strongest = largest_contributions(
            splats, cameras, rasterizer, on_progress, torch.where(always_kept, torch.inf, 0.0), enough=HALF_STEP
        )
        self.drawn = strongest > 0
        self.kept = self._kept(splats, strongest)

    def _kept(self, splats: Splats, strongest: Tensor) -> Bool[Tensor, " n"]:
        """All Gaussians but the faintest, of which as many go as together weigh at most HALF_STEP in every pixel.

        Leaving out a Gaussian of weight w = alpha T changes a pixel by w |c - B|, with c its colour and B what is
        behind it. Taken from back to front, those in front keep their weights, so a set changes a pixel by at most the
        sum of its w times the brightest colour. That sum is rendered: it is the picture in which the set is white and
        all others are black.
        """
        order = torch.argsort(strongest, stable=True)
        never = int((strongest == 0).sum())
        more = int((strongest <= HALF_STEP).sum()) - never
        while more and not self._weigh_little(splats, order[: never + more]):
            more //= 2
        kept = torch.ones(len(splats), dtype=torch.bool, device=strongest.device)
        kept[order[: never + more]] = False
        return kept

    def _weigh_little(self, splats: Splats, rows: Tensor) -> bool:
        """Whether the weights of these Gaussians add up to at most HALF_STEP in every pixel of every view."""
        shown = splats.marked(rows)
        return all(self.rasterizer.render(shown, camera).max() <= HALF_STEP for camera in self.cameras)

    @torch.no_grad()
    def __call__(self, baked: Splats) -> Pruned:
        """The pruned look, in which no pixel of any view changes by more than HALF_STEP.

        This is checked by rendering: the lowest SH degree that keeps the bound in every view is taken. If none does,
        because the look is very bright, only Gaussians that no view draws are left out, which changes nothing.
        """
        if not self.drawn.any():
            return Pruned(baked)
        kept = baked[self.kept]
        options = [kept.up_to_degree(degree) for degree in range(baked.degree + 1)]
        if torch.equal(self.kept, self.drawn):
            options.pop()  # needs no check: it is what remains if no other keeps the bound
        largest = [0.0] * len(options)
        for camera in self.cameras:
            if min(largest, default=1.0) > HALF_STEP:
                break
            whole = self._shown(baked, camera)
            for number, option in enumerate(options):
                if largest[number] <= HALF_STEP:
                    change = float((self._shown(option, camera) - whole).abs().max())
                    largest[number] = max(largest[number], change)
        for option, change in zip(options, largest, strict=True):
            if change <= HALF_STEP:
                return Pruned(option, len(baked) - len(option), baked.degree - option.degree, change * 255)
        return Pruned(baked[self.drawn], int((~self.drawn).sum()))

    def _shown(self, baked: Splats, camera: Camera) -> Tensor:
        return self.rasterizer.render(baked, camera, self.background).clamp(0, 1)


def pruner_of(trained: TrainedRun, report: Report) -> Pruner:
    """The Pruner of a run for its training views at training size; the photos themselves are not needed."""
    cameras = [trained.camera(photo) for photo in trained.collection.split("train")]
    return Pruner(
        trained.splats,
        cameras,
        trained.rasterizer,
        trained.sky_count,
        trained.background,
        partial(report.progress, "Pruning"),
    )
