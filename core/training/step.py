"""One training step, from a photo to the update of networks and Gaussians, in the order in which it happens.

A name in `_later` is a result that is still being computed beside what follows: calling it waits for it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

from core.appearance.model import AppearanceModel, Reading
from core.appearance.sh_transfer import TransferInput
from core.config import Settings
from core.rasterizer import Rasterizer, Visible
from core.rasterizer.view import WIDTH, view_of
from core.system import threads
from core.system.device import sent, sent_together
from core.training import guards, network_updates, schedule
from core.training.background import background_of_step
from core.training.gaussians import densify
from core.training.gaussians.gaussians import Gaussians, learning_rates, splats_of
from core.training.guards import StepFacts
from core.training.jitter import draw_gain, jittered
from core.training.losses.backward import backward
from core.training.losses.objective import Objective
from core.training.losses.photometric import Target
from core.training.moment import Moment
from core.training.sized_photos import SizedPhotos
from core.training.transparency import transparent_is_empty

Result = TypeVar("Result")


@dataclass(frozen=True)
class StepInputs:
    """The numbers that differ between two steps, where they are computed.

    encoder_input: the photo as the encoder takes it; target: as the picture's; gain: (3,), of the exposure that both are seen in, None for their
    own. view: the camera, see core.rasterizer.view. rates: of the Gaussians, see `learning_rates`; network_rates: of the networks, see
    `network_updates`. gauge_rows: see `Objective.gauge`. The others are known when the step before is over: largest_loss: (), see `guards`.
    mask_mean: (), see `mask_weights`. neutral: (e,), the mean embedding.
    """

    encoder_input: Tensor
    target: Target
    gain: Tensor | None
    view: Tensor
    rates: dict[str, Tensor]
    network_rates: list[float] | list[Tensor]
    gauge_rows: Tensor | None
    largest_loss: Tensor
    mask_mean: Tensor
    neutral: Tensor

    @property
    def tensors(self) -> list[Tensor]:
        """All tensors in it, in the order of the fields."""
        found = []
        for part in vars(self).values():
            if isinstance(part, Target):
                found += part.tensors
            elif isinstance(part, dict):
                found += part.values()
            elif isinstance(part, list):
                found += part
            elif part is not None:
                found.append(part)
        return found


@dataclass(frozen=True)
class PreparedStep:
    """A step that is yet to be taken, with its random draws.

    inputs: makes its inputs of those that are known when the step before is over: largest_loss, mask_mean and neutral, given by name.
    """

    moment: Moment
    inputs: Callable[..., StepInputs]


class Found(NamedTuple):
    """What the camera of a step shows. shown: how many rows of that are Gaussians, see `regularisers.residual_loss`. complete: whether it is all.
    needed: numbers (), of the room that all of it takes, where room is limited.
    """

    visible: Visible
    shown: Tensor | None = None
    complete: Tensor | bool = True
    needed: tuple[Tensor, ...] = ()


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

    def prepare(self, gaussians: Gaussians, index: int, done: int) -> PreparedStep:
        """Prepare a step, drawing its random numbers. index: the photo's. done: steps before this one."""
        settings, generator, progress = self.settings, self.generator, done / self.settings.steps
        camera, target = self.photos.target(index, schedule.shrink_factor(settings, progress))
        gain, view, rates = draw_gain(settings, generator), view_of(camera), learning_rates(settings, progress)
        network_rates = network_updates.rates_at(self.optimizer, progress)
        gauge_rows = self.objective.drawn_for_gauge(gaussians, generator)
        background = background_of_step(transparent_is_empty(settings), generator)

        encoder_input = self.photos[index].encoder_input
        if (device := encoder_input.device).type != "cpu":  # what the host made is copied there without waiting
            gains = [] if gain is None else [gain]
            on_device, *others = sent_together([torch.tensor(network_rates), *rates.values(), *gains], device)
            network_rates, gain = list(on_device.unbind()), others.pop() if gains else None
            rates = dict(zip(rates, others, strict=True))
            view, gauge_rows = sent(view, device), None if gauge_rows is None else sent(gauge_rows, device)
        inputs = partial(StepInputs, encoder_input, target, gain, view, rates, network_rates, gauge_rows)
        return PreparedStep(Moment(index, done, progress, camera, background), inputs)

    def take(
        self, gaussians: Gaussians, prepared: PreparedStep, usual: float, mask_mean: float, meanwhile: Callable[[], None]
    ) -> tuple[Reading, StepFacts]:
        """Render a photo's view in its look, compare, and learn; an invalid step teaches nothing.

        usual: the picture loss to expect, see `guards`. mask_mean: see `mask_weights`. meanwhile: what the host may do while a GPU is
        at the step, once or more often; on a CPU it is not called. Returns what was read in the photo, and the facts, as numbers.
        """
        left = sent(torch.tensor([guards.largest_loss(usual), mask_mean]), self.objective.zero.device)
        inputs = prepared.inputs(largest_loss=left[0], mask_mean=left[1], neutral=self.model.mean_embedding)
        return self._compute(gaussians, inputs, prepared.moment, meanwhile)

    def forget(self) -> None:
        """Keep nothing of the Gaussians: they are about to grow in number, to be removed or replaced."""

    def _compute(self, gaussians: Gaussians, inputs: StepInputs, moment: Moment, meanwhile: Callable[[], None]) -> tuple[Reading, StepFacts]:
        """The step from here on, by its inputs."""
        reading, facts = self._learn(gaussians, inputs, moment)
        return reading, StepFacts(*facts.cpu().tolist())

    def _beside(self, work: Callable[[], Result]) -> Callable[[], Result]:
        """See `threads.beside`."""
        return threads.beside(work)

    def _find_visible(self, gaussians: Gaussians, inputs: StepInputs, moment: Moment) -> Found:
        """What the camera of the step shows."""
        return Found(self.rasterizer.visible(gaussians.splats, moment.camera))

    def _learn(self, gaussians: Gaussians, inputs: StepInputs, moment: Moment) -> tuple[Reading, Tensor]:
        """The step itself; its facts are one tensor, in the order of StepFacts, and behind them what was `needed`."""
        model, objective = self.model, self.objective
        if self.optimizer is not None:
            self.optimizer.zero_grad()

        # The photo, read by the encoder, then the gauge. Meanwhile, which Gaussians the photo's camera shows.
        def read_photo() -> tuple[Reading, Target]:
            encoder_input, target = jittered(inputs.encoder_input, inputs.target, inputs.gain)
            return model.read(encoder_input, moment.index), target.over(moment.background)

        read_later = self._beside(read_photo)
        gauge_loss_later = self._beside(lambda: objective.gauge(gaussians, inputs.gauge_rows, inputs.neutral))
        visible, shown, complete, needed = self._find_visible(gaussians, inputs, moment)
        leaves = gaussians.leaves(visible.rows)
        reading, target = read_later()

        # The visible Gaussians in that look, and their picture. Gradients end in embedding, leaves and probe: zeros added to the centres (px).
        embedding = reading.embedding.detach().requires_grad_()
        sh, residual = model.transfer(TransferInput(leaves["sh"], leaves["means"].detach(), leaves.get("latents")), embedding)
        residual_loss_later = self._beside(lambda: objective.residual(residual, shown))
        splats = splats_of(leaves).with_sh(sh)
        probe = torch.zeros(len(visible.rows), 2, requires_grad=True, device=visible.rows.device)
        image = self.rasterizer.render(splats, moment.camera, moment.background, probe, visible.known)

        # What the step minimises.
        mask_loss_later = self._beside(lambda: objective.mask(image, target, reading.mask, moment))
        picture_loss = objective.picture(image, target, reading.mask, moment, inputs.mask_mean)
        transient_loss = objective.transient(splats, inputs.view, visible.known, reading.mask, moment)
        rendered_loss = picture_loss + transient_loss
        residual_loss, residual_gradient, residual_size = residual_loss_later()
        mask_loss = mask_loss_later()
        loss = rendered_loss.detach() + residual_loss + mask_loss.detach() + gauge_loss_later()
        sound = complete & guards.sound(loss, picture_loss.detach(), inputs.largest_loss)

        # The gradients, then the updates.
        def teach_encoder() -> None:
            backward((reading.embedding, embedding.grad), (mask_loss, None))

        taken = learned = sound
        if not guards.refused(sound):
            with network_updates.encoder_backward_beside(teach_encoder, embedding, self._beside):
                backward((rendered_loss, None), (residual, residual_gradient))
            reached = *leaves.values(), embedding, *model.transfer_parameters()
            taken = sound & guards.finite((tensor.grad for tensor in reached), sound.device)
            if not guards.refused(taken):
                half_size = inputs.view[WIDTH:].float() / 2  # of the picture
                densify.gather(gaussians, visible.rows, probe.grad, half_size, taken)
                gaussians.step(visible.rows, leaves, inputs.rates, taken)
            learned = network_updates.update(self.optimizer, inputs.network_rates, taken)  # not if another gradient overflows

        reading = reading.detached()  # which lets autograd's graph go
        shown_share = objective.zero if reading.mask is None else reading.mask.mean()
        facts = StepFacts(loss, picture_loss.detach(), residual_size, shown_share, sound, taken, learned)
        return reading, torch.stack([fact.double() for fact in (*facts, *needed)])
