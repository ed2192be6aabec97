"""What a step minimises: each loss with its weight, from the progress of the run at which it starts."""

from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Generator, Tensor

from core.appearance.model import AppearanceModel
from core.config import Settings
from core.rasterizer import Rasterizer
from core.scene.splats import Splats
from core.training.gaussians.gaussians import Gaussians
from core.training.losses import mask_weights, regularisers
from core.training.losses.backward import backward
from core.training.losses.gauge import draw_rows, gauge
from core.training.losses.mask_loss import mask_loss
from core.training.losses.photometric import Target, photometric, photometric_of_mask, photometric_paper
from core.training.step_context import StepContext

# Steps: L_regTS is computed in one of so many, because it takes a pass of its own, and weighted by as much.
TRANSIENT_EVERY = 10


class Objective:
    """The losses of a step, as the settings have them; those that have not started yet are zero."""

    def __init__(self, settings: Settings, rasterizer: Rasterizer, model: AppearanceModel, device: torch.device):
        self.settings, self.rasterizer, self.model = settings, rasterizer, model
        self.zero = torch.zeros((), device=device)

    def picture(
        self,
        image: Float[Tensor, "H W 3"],
        target: Target,
        mask: Float[Tensor, "1 h w"] | None,
        context: StepContext,
        mask_mean: Float[Tensor, ""],
    ) -> Float[Tensor, ""]:
        """The picture loss, with the mask once it applies. mask_mean: see `mask_weights.pixel_weights`."""
        settings = self.settings
        if mask is None or context.progress < settings.mask_apply:
            return photometric(image, target, None, settings.ssim_weight)
        weight = mask_weights.pixel_weights(target.to_pixels(mask), mask_mean)
        loss = photometric_paper if settings.mask_loss == "paper" else photometric
        return loss(image, target, weight, settings.ssim_weight)

    def mask(
        self, image: Float[Tensor, "H W 3"], target: Target, mask: Float[Tensor, "1 h w"] | None, context: StepContext
    ) -> Float[Tensor, ""]:
        """The mask network's loss, L_regM included."""
        settings = self.settings
        if mask is None or context.progress < settings.mask_start:
            return self.zero
        if settings.mask_loss == "paper":
            penalty = settings.mask_regularisation * regularisers.mask_regulariser(mask)
            return photometric_of_mask(image, target, target.to_pixels(mask), settings.ssim_weight) + penalty
        return mask_loss(mask, image, target, settings.mask_regularisation)

    def residual(
        self, residual: Float[Tensor, "v c 3"] | None, shown: Int[Tensor, ""] | None
    ) -> regularisers.ResidualLoss:
        """L_regSH; see `regularisers.residual_loss`."""
        if residual is None:
            return regularisers.ResidualLoss(self.zero, None, self.zero)
        return regularisers.residual_loss(residual, self.settings.sh_regularisation, shown)

    def draw_gauge_rows(self, gaussians: Gaussians, generator: Generator) -> Int[Tensor, " 1024"] | None:
        """See `gauge.draw_rows`; None where the gauge does not count."""
        if not (self.settings.gauge and self.model.predicts_residuals and len(gaussians)):
            return None
        return draw_rows(gaussians, generator)

    def gauge(
        self, gaussians: Gaussians, rows: Int[Tensor, " 1024"] | None, neutral: Float[Tensor, " e"]
    ) -> Float[Tensor, ""]:
        """The gauge of these rows, after its backward pass, which can run at once as it reaches only the networks."""
        transfer = self.model.sh_transfer
        if rows is None or transfer is None:
            return self.zero
        loss = self.settings.gauge * gauge(transfer, gaussians, rows, neutral)
        backward((loss, None))
        return loss.detach()

    def has_transient_loss(self, context: StepContext) -> bool:
        """Whether this step has L_regTS."""
        settings = self.settings
        return settings.has_masks and context.progress >= settings.mask_apply and context.done % TRANSIENT_EVERY == 0

    def transient(
        self,
        splats: Splats,
        view: Float[Tensor, "25"],
        known: Any,
        mask: Float[Tensor, "1 h w"] | None,
        context: StepContext,
    ) -> Float[Tensor, ""]:
        """L_regTS, if this step has it: the summed opacity of `regularisers.transient_rows`.

        splats: the visible Gaussians in the look. view: the step's camera as an array, see core.rasterizer.view. known:
        see `rasterizer.Visible`.
        """
        if mask is None or not self.has_transient_loss(context):
            return self.zero
        front = self.rasterizer.contributions(splats.detached(), context.camera, known)
        rows = regularisers.transient_rows(splats.means, front, mask, view)
        opacity = torch.where(rows, torch.sigmoid(splats.logit_opacities), 0).sum()
        return self.settings.transient_regularisation * TRANSIENT_EVERY * opacity
