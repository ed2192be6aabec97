"""One training step, from a photo to the update of networks and Gaussians, in the order in which it happens.

A name in `_later` is a result that may still be in computation on another thread or stream: calling it waits for the
result.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

from core.appearance.model import AppearanceModel, Reading
from core.appearance.sh_transfer import TransferInput
from core.config import Settings
from core.rasterizer import Rasterizer, Visible
from core.rasterizer.view import WIDTH, view_of
from core.run.background import background_of_step
from core.system import threads
from core.system.device import sent, sent_together
from core.training import guards, network_updates, schedule
from core.training.gaussians import densify
from core.training.gaussians.gaussians import Gaussians, learning_rates, splats_of
from core.training.guards import StepFacts
from core.training.jitter import draw_gain, jittered
from core.training.losses.backward import backward
from core.training.losses.objective import Objective
from core.training.losses.photometric import Target
from core.training.network_adam import NetworkAdam
from core.training.sized_photos import SizedPhotos
from core.training.step_context import StepContext

Result = TypeVar("Result")


@dataclass(frozen=True)
class StepInputs:
    """What differs between two steps, on the device that computes them."""

    encoder_input: Tensor  # the photo as the encoder takes it
    target: Target  # the photo as the picture loss takes it
    gain: Tensor | None  # (3,), a random exposure for both, or None
    view: Tensor  # the camera, see core.rasterizer.view
    rates: dict[str, Tensor]  # learning rates of the Gaussians, see `learning_rates`
    network_rates: list[float] | list[Tensor]  # learning rates of the networks, see `network_updates.rates_at`
    gauge_rows: Tensor | None  # see `Objective.draw_gauge_rows`
    # What follows from the steps before.
    largest_loss: Tensor  # (), see `guards`
    mask_mean: Tensor  # (), see `mask_weights`
    neutral: Tensor  # (e,), the mean embedding

    @property
    def tensors(self) -> list[Tensor]:
        """All tensors in it, in the order of the fields."""
        found: list[Tensor] = []
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
    """A step that is ready to be taken: its random numbers are drawn.

    inputs: makes its StepInputs from largest_loss, mask_mean and neutral, which are known only once the previous step
    is over.
    """

    context: StepContext
    inputs: Callable[..., StepInputs]


class InView(NamedTuple):
    """The Gaussians that a step's camera shows. On a GPU there is limited room for them,
    and what they leave of it is padding.

    shown: (), how many rows are Gaussians, None for all; see `regularisers.residual_loss`. complete: (), whether there
    was room for all of them. needed: scalars, the room that all of them take, where room is limited.
    """

    visible: Visible
    shown: Tensor | None = None
    complete: Tensor | bool = True
    needed: tuple[Tensor, ...] = ()


@dataclass
class Stepper:
    """Prepares and takes the steps of a run, on what all of them share.
    generator: of their random numbers. messages: warnings that the user has not been told yet."""

    settings: Settings
    photos: SizedPhotos
    model: AppearanceModel
    optimizer: NetworkAdam
    objective: Objective
    rasterizer: Rasterizer
    generator: torch.Generator
    messages: list[str] = field(default_factory=list)

    def prepare(self, gaussians: Gaussians, index: int, done: int) -> PreparedStep:
        """Prepare a step, drawing its random numbers. index: the photo's. done: steps before this one."""
        settings, generator, progress = self.settings, self.generator, done / self.settings.steps
        camera, target = self.photos.target(index, schedule.shrink_factor(settings, progress))
        gain, view, rates = draw_gain(settings, generator), view_of(camera), learning_rates(settings, progress)
        network_rates: list[float] | list[Tensor] = network_updates.rates_at(self.optimizer, progress)
        gauge_rows = self.objective.draw_gauge_rows(gaussians, generator)
        background = background_of_step(settings.transparent_is_empty, generator)

        encoder_input = self.photos[index].encoder_input
        if (device := encoder_input.device).type != "cpu":  # copied there without waiting, in few copies
            numbers = {"network": torch.tensor(network_rates), **rates} | ({} if gain is None else {"gain": gain})
            numbers = dict(zip(numbers, sent_together([*numbers.values()], device), strict=True))
            network_rates, gain = list(numbers.pop("network").unbind()), numbers.pop("gain", None)
            rates = numbers
            view, gauge_rows = sent(view, device), None if gauge_rows is None else sent(gauge_rows, device)
        inputs = partial(
            StepInputs,
            encoder_input=encoder_input,
            target=target,
            gain=gain,
            view=view,
            rates=rates,
            network_rates=network_rates,
            gauge_rows=gauge_rows,
        )
        return PreparedStep(StepContext(index, done, progress, camera, background), inputs)

    def take(
        self,
        gaussians: Gaussians,
        prepared: PreparedStep,
        usual: float,
        mask_mean: float,
        meanwhile: Callable[[], None],
    ) -> tuple[Reading, StepFacts]:
        """Render a photo's view in its look, compare, and learn; an invalid step teaches nothing.

        usual: the usual picture loss, see `guards`. mask_mean: see `mask_weights`. meanwhile: work of the host while a
        GPU computes the step; called once or more there, and not on a CPU. Returns what was read from the photo, and
        the facts.
        """
        largest_loss, mean = sent(torch.tensor([guards.largest_loss(usual), mask_mean]), self.photos.device).unbind()
        inputs = prepared.inputs(largest_loss=largest_loss, mask_mean=mean, neutral=self.model.mean_embedding)
        return self._compute(gaussians, inputs, prepared.context, meanwhile)

    def forget(self) -> None:
        """Drop what was kept for the present Gaussians, which are about to change in number or to be replaced."""

    def _compute(
        self, gaussians: Gaussians, inputs: StepInputs, context: StepContext, meanwhile: Callable[[], None]
    ) -> tuple[Reading, StepFacts]:
        """Take the step with these inputs, and read its facts back."""
        reading, facts = self._learn(gaussians, inputs, context)
        return reading, StepFacts.of(facts.cpu().tolist())

    def _beside(self, work: Callable[[], Result]) -> Callable[[], Result]:
        """See `threads.beside`."""
        return threads.beside(work)

    def _find_visible(self, gaussians: Gaussians, inputs: StepInputs, context: StepContext) -> InView:
        """The Gaussians that the step's camera shows."""
        return InView(self.rasterizer.visible(gaussians.splats, context.camera))

    def _learn(self, gaussians: Gaussians, inputs: StepInputs, context: StepContext) -> tuple[Reading, Tensor]:
        """The step itself. Its facts are one tensor, so that they are read back at once:
        those of StepFacts, then `InView.needed`."""
        model, objective = self.model, self.objective
        self.optimizer.zero_grad()

        # Beside the search for the visible Gaussians: the encoder reads the photo, and then the gauge is computed.
        def read_photo() -> tuple[Reading, Target]:
            encoder_input, target = jittered(inputs.encoder_input, inputs.target, inputs.gain)
            return model.read(encoder_input, context.index), target.over(context.background)

        read_later = self._beside(read_photo)
        gauge_loss_later = self._beside(lambda: objective.gauge(gaussians, inputs.gauge_rows, inputs.neutral))
        visible, shown, complete, needed = self._find_visible(gaussians, inputs, context)
        leaves = gaussians.leaves(visible.rows)
        reading, target = read_later()

        # Render the visible Gaussians in the photo's look. Gradients end in embedding, leaves and probe (zeros added to
        # the projected centres, px).
        embedding = reading.embedding.detach().requires_grad_()
        sh, residual = model.transfer(
            TransferInput(leaves["sh"], leaves["means"].detach(), leaves.get("latents")), embedding
        )
        residual_loss_later = self._beside(lambda: objective.residual(residual, shown))
        splats = splats_of(leaves).with_sh(sh)
        probe = torch.zeros(len(visible.rows), 2, requires_grad=True, device=visible.rows.device)
        image = self.rasterizer.render(splats, context.camera, context.background, probe, visible.known)

        # What the step minimises.
        mask_loss_later = self._beside(lambda: objective.mask(image, target, reading.mask, context))
        picture_loss = objective.picture(image, target, reading.mask, context, inputs.mask_mean)
        transient_loss = objective.transient(splats, inputs.view, visible.known, reading.mask, context)
        rendered_loss = picture_loss + transient_loss
        residual_loss, residual_gradient, residual_size = residual_loss_later()
        mask_loss = mask_loss_later()
        loss = rendered_loss.detach() + residual_loss + mask_loss.detach() + gauge_loss_later()
        sound = complete & guards.sound(loss, picture_loss.detach(), inputs.largest_loss)

        # Gradients, then updates. `sound`, `taken` and `learned` are explained in StepFacts.
        def teach_encoder() -> None:
            backward((reading.embedding, embedding.grad), (mask_loss, None))

        taken = learned = sound
        if not guards.known_invalid(sound):
            with network_updates.encoder_backward_beside(teach_encoder, embedding, self._beside):
                backward((rendered_loss, None), (residual, residual_gradient))
            reached = *leaves.values(), embedding, *model.transfer_parameters()
            taken = sound & guards.finite((tensor.grad for tensor in reached), sound.device)
            if not guards.known_invalid(taken):
                half_size = inputs.view[WIDTH:].float() / 2  # of the picture
                assert probe.grad is not None  # every rasterizer gives it one
                densify.gather(gaussians, visible.rows, probe.grad, half_size, taken)
                gaussians.step(visible.rows, leaves, inputs.rates, taken)
            learned = network_updates.update(self.optimizer, inputs.network_rates, taken)

        reading = reading.detached()  # frees autograd's graph
        shown_share = objective.zero if reading.mask is None else reading.mask.mean()
        facts = loss, picture_loss.detach(), residual_size, shown_share, sound, taken, learned
        return reading, torch.stack([fact.double() for fact in (*facts, *needed)])
