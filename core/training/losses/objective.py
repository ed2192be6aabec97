"""What a step minimises: each loss with its weight, from the point of the run at which it begins to count."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from core.appearance.model import AppearanceModel
from core.config import Settings
from core.rasterizer import Rasterizer
from core.scene.camera import Camera
from core.scene.splats import Splats
from core.system.cuda_graph import Replayed
from core.training.gaussians.gaussians import Gaussians
from core.training.losses import mask_weights, regularisers
from core.training.losses.backward import backward
from core.training.losses.gauge import Gauge
from core.training.losses.mask_loss import CellLoss, cells_of
from core.training.losses.photometric import Target, photometric, photometric_of_mask, photometric_paper

TRANSIENT_EVERY = 10  # steps between two looks at who stands at the front; L_regTS is weighted up by as much


class Objective:
    """The losses of a view, as the settings have them. progress: of the run, in [0, 1). What does not count yet is zero."""

    def __init__(self, settings: Settings, rasterizer: Rasterizer, model: AppearanceModel, device: torch.device):
        self.settings, self.rasterizer = settings, rasterizer
        self.zero = torch.zeros((), device=device)
        self.cell_loss = Replayed(CellLoss(settings.mask_regularisation))
        self.gauge_loss = Gauge(model)

    def picture(self, image: Tensor, target: Target, mask: Tensor | None, progress: float, mask_mean: float) -> Float[Tensor, ""]:
        """The picture against its photo, where the mask lets it. mask_mean: see `mask_weights.pixel_weights`."""
        settings = self.settings
        if mask is None or progress < settings.mask_apply:
            return photometric(image, target, None, settings.ssim_weight)
        weight = mask_weights.pixel_weights(mask, *image.shape[:2], mask_mean)
        loss = photometric_paper if settings.mask_loss == "paper" else photometric
        return loss(image, target, weight, settings.ssim_weight)

    def mask(self, image: Tensor, target: Target, mask: Tensor | None, progress: float) -> Float[Tensor, ""]:
        """What teaches the mask network, L_regM included."""
        settings = self.settings
        if mask is None or progress < settings.mask_start:
            return self.zero
        if settings.mask_loss == "paper":
            shown = mask_weights.enlarged(mask, *image.shape[:2])
            penalty = settings.mask_regularisation * regularisers.mask_regulariser(mask)
            return photometric_of_mask(image, target, shown, settings.ssim_weight) + penalty
        if target.valid is not None:  # the target is zero there
            image = torch.where(target.valid[..., None], image, 0)
        (loss,) = self.cell_loss(mask, *cells_of(mask, image, target.planes))
        return loss

    def residual(self, residual: Float[Tensor, "v c 3"] | None) -> tuple[Tensor, Tensor | None, Tensor]:
        """L_regSH, its gradient and the residual's size, as `regularisers.residual_loss` has them."""
        if residual is None:
            return self.zero, None, self.zero
        return regularisers.residual_loss(residual, self.settings.sh_regularisation)

    def gauge(self, gaussians: Gaussians, generator: Generator) -> Float[Tensor, ""]:
        """The gauge. Its backward pass is here, too: it reaches nothing but the networks."""
        if not self.settings.gauge:
            return self.zero
        loss = self.settings.gauge * self.gauge_loss(gaussians, generator)
        backward((loss, None))
        return loss.detach()

    def transient(self, splats: Splats, camera: Camera, known: Any, mask: Tensor | None, progress: float, step: int) -> Float[Tensor, ""]:
        """L_regTS, at every TRANSIENT_EVERYth step. splats: the visible Gaussians in the look. known: see `rasterizer.Visible`."""
        settings = self.settings
        if mask is None or progress < settings.mask_apply or step % TRANSIENT_EVERY:
            return self.zero
        front = self.rasterizer.contributions(splats.detached(), camera, known)
        rows = regularisers.transient_rows(splats.means, front, mask, camera)
        opacity = torch.where(rows, torch.sigmoid(splats.logit_opacities), 0).sum()
        return settings.transient_regularisation * TRANSIENT_EVERY * opacity
