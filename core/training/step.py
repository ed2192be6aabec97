"""One training step, from a photo to the update of networks and Gaussians, in the order in which it happens.

A name in `_later` is a result that is still being computed beside what follows: calling it waits for it.
"""

from dataclasses import dataclass

import torch

from core.appearance.model import AppearanceModel, Reading
from core.config import Settings
from core.rasterizer import Rasterizer, Visible
from core.system.device import OnTheWay
from core.system.threads import beside
from core.training import guards, network_updates, schedule
from core.training.background import background_of_step
from core.training.gaussians import densify
from core.training.gaussians.gaussians import Gaussians, learning_rates, splats_of
from core.training.guards import StepFacts
from core.training.jitter import draw_gain, jittered
from core.training.losses.backward import backward
from core.training.losses.objective import Objective
from core.training.losses.photometric import Target
from core.training.sized_photos import SizedPhotos
from core.training.transparency import transparent_is_empty


@dataclass
class Stepper:
    """Takes the steps of a run, with what they all work with. generator: of their random draws."""

    settings: Settings
    photos: SizedPhotos
    model: AppearanceModel
    optimizer: torch.optim.Adam | None
    objective: Objective
    rasterizer: Rasterizer
    generator: torch.Generator

    def take(self, gaussians: Gaussians, index: int, done: int, usual: float, mask_mean: float, foreseen: Visible | None) -> tuple[Reading, OnTheWay]:
        """Draw a photo's view in its look, compare, and learn; an invalid step teaches nothing.

        index: the photo's. done: steps before this one. usual: the picture loss to expect, see `guards`. mask_mean: see `mask_weights.pixel_weights`.
        foreseen: what the photo shows, where that is known. Returns what was read in the photo, and the StepFacts, on their way from the device.
        """
        settings, model, objective = self.settings, self.model, self.objective
        progress = done / settings.steps
        if self.optimizer is not None:
            self.optimizer.zero_grad()
        camera, photo = self.photos.target(index, schedule.shrink_factor(settings, progress))
        gain, background = draw_gain(settings, self.generator), background_of_step(transparent_is_empty(settings), self.generator)

        # The photo, read by the encoder, then the gauge. Meanwhile, which Gaussians the photo's camera shows.
        def read_photo() -> tuple[Reading, Target]:
            shown, target = jittered(self.photos[index].encoder_input, photo, gain)
            return model.read(shown, index), target.over(background)

        read_later = beside(read_photo)
        gauge_loss_later = beside(lambda: objective.gauge(gaussians, self.generator))
        visible = foreseen or self.rasterizer.visible(gaussians.splats, camera)
        leaves = gaussians.leaves(visible.rows)
        reading, target = read_later()

        # The visible Gaussians in that look, and their picture. Gradients end in embedding, leaves and probe: zeros added to the centres (px).
        embedding = reading.embedding.detach().requires_grad_()
        sh, residual = model.transfer(leaves["sh"], leaves["means"].detach(), embedding, leaves.get("latents"))
        residual_loss_later = beside(lambda: objective.residual(residual))
        splats = splats_of(leaves).with_sh(sh)
        probe = torch.zeros(len(visible.rows), 2, requires_grad=True, device=visible.rows.device)
        image = self.rasterizer.render(splats, camera, background, probe, visible.known)

        # What the step minimises.
        mask_loss_later = beside(lambda: objective.mask(image, target, reading.mask, progress))
        picture_loss = objective.picture(image, target, reading.mask, progress, mask_mean)
        rendered_loss = picture_loss + objective.transient(splats, camera, visible.known, reading.mask, progress, done)
        residual_loss, residual_gradient, residual_size = residual_loss_later()
        mask_loss = mask_loss_later()
        loss = rendered_loss.detach() + residual_loss + mask_loss.detach() + gauge_loss_later()
        sound = guards.sound(loss, picture_loss.detach(), usual)

        # The gradients, then the updates.
        def teach_encoder() -> None:
            backward((reading.embedding, embedding.grad), (mask_loss, None))

        taken = learned = sound
        if not guards.refused(sound):
            with network_updates.encoder_backward_beside(teach_encoder, embedding):
                backward((rendered_loss, None), (residual, residual_gradient))
            reached = *leaves.values(), embedding, *model.transfer_parameters()
            taken = sound & guards.finite((tensor.grad for tensor in reached), sound.device)
            if not guards.refused(taken):
                densify.gather(gaussians, visible.rows, probe.grad, camera.width, camera.height, taken)
                gaussians.step(visible.rows, leaves, learning_rates(settings, progress), taken)
            learned = network_updates.update(self.optimizer, progress, taken)  # not if the encoder's gradient overflows

        shown_share = objective.zero if reading.mask is None else reading.mask.detach().mean()
        facts = StepFacts(loss, picture_loss.detach(), residual_size, shown_share, sound, taken, learned)
        return reading, OnTheWay(torch.stack([fact.float() for fact in facts]))
