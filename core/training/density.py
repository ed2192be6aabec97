"""Density control through a run: when Gaussians grow in number, and when and why some are removed."""

from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from core.appearance.model import AppearanceModel
from core.config import Settings
from core.rasterizer import Rasterizer
from core.rasterizer.importance import largest_contributions
from core.report import OnProgress, Report
from core.run.run_state import RunState
from core.scene.camera import Camera
from core.training import decisions, schedule
from core.training.gaussians import densify
from core.training.gaussians.gaussians import Gaussians
from core.training.gaussians.passers_by import passers_by
from core.training.gaussians.veils import veils
from core.training.losses import mask_weights
from core.training.progress import within_step
from core.training.sized_photos import SizedPhotos

FIRST_BUDGET = 0.25  # of max_gaussians; what growth may reach rises from there to all of it


class DensityControl:
    """Density control of one run, between its steps.

    points: from SfM, (M, 3), scene frame. model: predicts the masks. generator: draws the positions of split Gaussians.
    report: is told how far the slow parts are.
    """

    def __init__(
        self,
        settings: Settings,
        points: np.ndarray,
        photos: SizedPhotos,
        model: AppearanceModel,
        rasterizer: Rasterizer,
        generator: torch.Generator,
        report: Report,
    ):
        self.settings, self.points, self.photos, self.model = settings, points, photos, model
        self.rasterizer, self.generator, self.report = rasterizer, generator, report
        self.surroundings = densify.Surroundings(points, settings.reach) if settings.reach else None
        self.grow_at, self.prune_at = schedule.densification_steps(settings), schedule.contribution_steps(settings)
        self.settled_at = schedule.settled_step(settings)

    def is_due(self, done: int) -> bool:
        """Whether anything changes after `done` steps."""
        return done in self.grow_at or done in self.prune_at or done in (self.settled_at, self.settings.steps)

    def change(self, gaussians: Gaussians, state: RunState) -> list[str]:
        """All that is scheduled after the steps done; a warning if it leaves only the sky."""
        done, before = state.done, gaussians.solid_count
        if done in self.prune_at:
            self.prune_by_contribution(gaussians, done)
            state.useless += before - gaussians.solid_count
        if done in self.grow_at:
            self.grow(gaussians, done, state.useless)
        if done == self.settled_at:
            self.clear_the_view(gaussians, done, state.mask_mean)
        if done == self.settings.steps:
            densify.thicken(gaussians)
        return [densify.ALL_GONE] if before and not gaussians.solid_count else []

    def grow(self, gaussians: Gaussians, done: int, useless: int) -> None:
        """One round: prune, then grow within a budget that rises from round to round and is max_gaussians in the last.
        useless: see RunState; they count as well, or growth would put as many in their place."""
        densify.prune(gaussians, self.settings, self.surroundings)
        now = sum(step <= done for step in self.grow_at) / len(self.grow_at)
        allowed = round(self.settings.max_gaussians * (FIRST_BUDGET + (1 - FIRST_BUDGET) * now)) - useless
        densify.grow(gaussians, allowed - gaussians.solid_count, self.generator)

    def prune_by_contribution(self, gaussians: Gaussians, done: int) -> None:
        """Remove the Gaussians that reach `prune_contribution` in no pixel of any training photo."""
        largest = largest_contributions(
            gaussians.splats, self.photos.cameras, self.rasterizer, self._progress(done, "pruning")
        )
        densify.prune_by_contribution(gaussians, largest, self.settings.prune_contribution)

    def clear_the_view(self, gaussians: Gaussians, done: int, mask_mean: float) -> None:
        """Remove what blocks the view from where no photo was taken:
        see `gaussians.veils` and `gaussians.passers_by`."""
        splats = gaussians.splats
        in_the_way = torch.zeros(len(gaussians), dtype=torch.bool, device=splats.means.device)
        if self.settings.remove_veils:
            in_the_way |= veils(
                splats, self.photos.cameras, self.points, self.rasterizer, self._progress(done, "veils")
            )
        if self.settings.remove_passers_by and self._masks_can_be_trusted(done, mask_mean):
            in_the_way |= passers_by(splats, self._masked_photos(self._progress(done, "passers-by")), self.rasterizer)
        gaussians.keep(~in_the_way)

    def _masks_can_be_trusted(self, done: int, mask_mean: float) -> bool:
        """Whether masks already hide anything, and if so passers-by rather than the place itself."""
        hide = self.settings.has_masks and done >= self.settings.mask_apply * self.settings.steps
        return hide and mask_mean >= mask_weights.LEAST_STATIC and len(self.photos) >= decisions.FEWEST_FOR_MASKS

    @torch.no_grad()
    def _masked_photos(self, on_progress: OnProgress) -> Iterator[tuple[Camera, Tensor]]:
        for index, sized in enumerate(self.photos):
            if (mask := self.model.read(sized.encoder_input, index).mask) is not None:
                yield sized.camera, mask
            on_progress(index + 1, len(self.photos))

    def _progress(self, done: int, what: str) -> OnProgress:
        return within_step(done, what, self.settings, self.report)
