"""The training loop: photos in, Gaussians and an appearance model out."""

import dataclasses
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

import core.rasterizer
from core.appearance.model import AppearanceModel
from core.config import Settings
from core.data.collection import Collection
from core.data.transparency import transparent_may_be_empty
from core.errors import BadInput, TrainingStopped
from core.report import QUIET, OnProgress, Report
from core.run import checkpoint, history, run_folders
from core.run.background import background_of_figures
from core.run.run_state import RunState
from core.run.sized_photo import Sizes
from core.system import device
from core.system.threads import one_torch_thread, threads_for_blocks
from core.training import decisions, guards, held_out, network_updates, schedule
from core.training.density import DensityControl
from core.training.gaussians.gaussians import Gaussians
from core.training.gaussians.initialisation import initial_gaussians
from core.training.losses import mask_weights
from core.training.losses.objective import Objective
from core.training.progress import within_step
from core.training.sized_photos import SizedPhotos
from core.training.step import PreparedStep, Stepper

SKIPS_TO_STOP = 10  # invalid steps in a row after which training stops
HELD_OUT_PHOTOS = 4  # photos in a check of held-out quality
MASK_MEAN_RATE = 0.05  # weight of one photo's mask in the running mean of all masks


@dataclass(frozen=True)
class NextStep:
    """A prepared step, and what its preparation changed, as it was before:
    the photos left in this round through all photos, and the random generator's state."""

    prepared: PreparedStep
    order_before: list[int]
    random_state_before: Tensor


@dataclass(frozen=True)
class StepReport:
    """What a step tells the user; all but the messages are columns of history.csv."""

    step: int  # steps done, this one included
    seconds: float  # of training until now, without the checks of held-out photos
    gaussians: int  # without the sky
    loss: float  # what the step minimised
    picture_loss: float  # the picture's part of `loss`
    mask_mean: float  # running mean of the masks, 1 where nothing is hidden
    residual: float  # mean absolute residual of the harmonics
    held_out_psnr: float | None = None  # dB; None where this step has no check
    held_out_ssim: float | None = None  # None where this step has no check
    messages: tuple[str, ...] = ()  # decisions and warnings worth a line


COLUMNS = tuple(item.name for item in dataclasses.fields(StepReport) if item.name != "messages")  # of history.csv


class Trainer:
    """One run. On a CPU, interrupting and resuming it changes no bit of the result.

    settings: as given, with what was left open decided from the photos. decisions: what was decided, and why; none for
    a resumed run. saves: the steps after which a checkpoint is written. report: is told how far the decoding of photos
    is, and what a long step is busy with.
    """

    def __init__(self, collection: Collection, settings: Settings, folder: Path, report: Report = QUIET):
        torch.manual_seed(settings.seed)
        self.collection, self.folder, self.report = collection, folder, report
        self.generator = torch.Generator().manual_seed(settings.seed)
        self.device = device.chosen(settings.device, settings.backend)
        # The device is recorded: a run is resumed only on the one it began on, and the sizes of its photos follow from
        # it.
        settings = settings.changed(device="cuda" if self.device.type == "cuda" else "cpu")
        self.rasterizer = core.rasterizer.create(settings.backend, self.device.type)
        sizes = Sizes.of(settings, collection.photos)
        self.on_cuda_kernels = self.rasterizer.name == "cuda" and self.device.type != "cpu"
        may_be_empty = transparent_may_be_empty(collection, settings)
        self.photos = SizedPhotos(collection.split("train"), sizes, self.device, may_be_empty, report)
        if not len(self.photos):
            what = f"{collection.root}: no photo is left to train on. {'; '.join(self.photos.notes)}."
            raise BadInput(what, "Copy them again; masks have to be white where a photo is to be used.")
        settings, self.decisions = decisions.decide(settings, collection.points, self.photos)
        self.settings = settings
        self.photos.share_canvas = self.on_cuda_kernels and not settings.transparent_is_empty
        self.held_out = SizedPhotos(
            collection.split("test")[:HELD_OUT_PHOTOS], sizes, self.device, settings.transparent_is_empty
        )
        self.model = AppearanceModel(settings, [sized.photo.name for sized in self.photos])
        # On the CPU, whatever the device: rounding decides the signs of principal components.
        if self.model.encoder is not None:
            on_progress = partial(report.progress, "First looks")
            self.model.encoder.initialise_embedding(picture.cpu() for picture in self._encoder_inputs(on_progress))
        self.model.to(self.device)
        self.optimizer = network_updates.optimizer_of(self.model, settings)
        self.objective = Objective(settings, self.rasterizer, self.model, self.device)
        self.stepper = self._stepper()
        self.gaussians = initial_gaussians(collection, settings, self.generator).to(self.device)
        self.density = DensityControl(
            settings=settings,
            points=collection.points,
            photos=self.photos,
            model=self.model,
            rasterizer=self.rasterizer,
            generator=self.generator,
            report=report,
        )
        self.saves = schedule.evenly(settings.checkpoints, settings.steps)
        self.state = RunState.at_start(len(self.photos))
        self.last_losses = guards.LastLosses(self.state.last_losses)
        self.ahead: NextStep | None = None  # the next step, if it was prepared while a GPU computed the last one

    @classmethod
    def of_new_run(cls, collection: Collection, settings: Settings, folder: Path, report: Report = QUIET) -> "Trainer":
        """A trainer, and a run folder made for it with the settings as they were decided."""
        trainer = cls(collection, settings, folder, report)
        run_folders.create(folder, collection, trainer.settings, trainer.decisions)
        return trainer

    def _encoder_inputs(self, on_progress: OnProgress) -> Iterator[Tensor]:
        """What the encoder sees of each photo; thousands of them take some ten seconds."""
        for number, sized in enumerate(self.photos, 1):
            yield sized.encoder_input
            on_progress(number, len(self.photos))

    def _stepper(self) -> Stepper:
        stepper_of: Callable[..., Stepper] = Stepper
        if self.on_cuda_kernels:
            from core.training.step_cuda import StepperOnGpu  # Triton, which not every machine has

            stepper_of = StepperOnGpu
        return stepper_of(
            settings=self.settings,
            photos=self.photos,
            model=self.model,
            optimizer=self.optimizer,
            objective=self.objective,
            rasterizer=self.rasterizer,
            generator=self.generator,
        )

    # --- the loop

    def train(self) -> Iterator[StepReport]:
        """Take all remaining steps, yielding a report after each;
        checkpoints and history.csv are written on the way."""
        settings, state = self.settings, self.state
        checks = schedule.evenly(settings.held_out_checks, settings.steps)
        if state.change_due:  # as memory ran out in it
            self.change_gaussians()
            if state.done in self.saves:
                self.save()
        while state.done < settings.steps:
            start = time.perf_counter()
            report = self.step()
            messages = (*report.messages, *self.change_gaussians())
            state.seconds += time.perf_counter() - start
            psnr, ssim = self.held_out_quality() if state.done in checks else (None, None)
            now, count = state.seconds, self.gaussians.solid_count
            report = dataclasses.replace(
                report, seconds=now, gaussians=count, held_out_psnr=psnr, held_out_ssim=ssim, messages=messages
            )
            if state.done in checks or state.done % max(1, settings.steps // 100) == 0:
                history.add_row(self.folder, COLUMNS, vars(report))
            if state.done in self.saves:
                self.save()
            yield report

    def step(self) -> StepReport:
        """Train on one photo; density control and checkpoints are left to `train`."""
        # A GPU's kernels are launched from Python, which runs one thread at a time.
        with threads_for_blocks() if self.device.type == "cpu" else one_torch_thread():
            return self._step()

    def _step(self) -> StepReport:
        state = self.state
        usual = self.last_losses.usual
        step, self.ahead = self.ahead or self._prepare(state.done), None
        prepared, context = step.prepared, step.prepared.context
        try:
            reading, facts = self.stepper.take(self.gaussians, prepared, usual, state.mask_mean, self._prepare_ahead)
        except Exception:  # such as out of memory: the checkpoint that is saved then resumes with this very step
            self._take_back(step.order_before, step.random_state_before)
            raise
        state.done += 1
        state.change_due = self.density.is_due(state.done)
        fault = guards.fault(facts, usual)
        if fault is None:
            state.skipped_in_a_row = 0
            self.last_losses.replace(context.index, facts.picture_loss)
            self.model.remember(reading.embedding, context.index)
            messages = [] if reading.mask is None else self._watch_masks(facts.shown_share, context.progress)
        else:
            outcome = "taught the networks nothing" if facts.taken else "was skipped"
            messages = [self._skip(context.index, fault, outcome)]
        messages += self.stepper.messages
        self.stepper.messages.clear()
        return StepReport(
            step=state.done,
            seconds=state.seconds,
            gaussians=self.gaussians.solid_count,
            loss=facts.loss,
            picture_loss=facts.picture_loss,
            mask_mean=state.mask_mean,
            residual=facts.residual_size,
            messages=tuple(messages),
        )

    def _watch_masks(self, shown_share: float, progress: float) -> list[str]:
        """Update the running mean of the masks; a warning, once, if they hide too much."""
        if progress < self.settings.mask_start:
            return []
        state = self.state
        state.mask_mean += MASK_MEAN_RATE * (shown_share - state.mask_mean)
        hides = progress >= self.settings.mask_apply
        if not hides or state.mask_mean >= mask_weights.LEAST_STATIC or state.collapse_told:
            return []
        state.collapse_told = True
        hidden = f"The masks hide {1 - state.mask_mean:.0%} of the photos"
        held = f"are held at {1 - mask_weights.LEAST_STATIC:.0%} from here on"
        return [f"{hidden} and {held}: raise mask_regularisation if the pictures in masks/ look wrong."]

    def _skip(self, index: int, fault: str, outcome: str) -> str:
        """Count an invalid step; its warning, or, after SKIPS_TO_STOP of them in a row,
        a checkpoint and TrainingStopped."""
        state, name = self.state, self.photos[index].photo.name
        state.skipped += 1
        state.skipped_in_a_row += 1
        if state.skipped_in_a_row >= SKIPS_TO_STOP:
            state.skipped_in_a_row = 0  # once resumed, the run may skip as many again
            self.change_gaussians()  # now, because the resumed run begins with the next step
            path = self.save()
            raise TrainingStopped(
                f"{SKIPS_TO_STOP} steps in a row were invalid; "
                f"in the last one, the {fault} (photo {name}). Saved {path}.",
                "Lower the learning rates (`--set mean_rate=...`) or remove the photo, then train again.",
            )
        return f"Step {state.done} {outcome}: its {fault} (photo {name})."

    def _prepare(self, done: int) -> NextStep:
        """Prepare the step after `done` others, on the next photo of `order`."""
        state, random_state = self.state, self.generator.get_state()
        order = list(state.order)
        try:
            if not state.order:
                state.order = torch.randperm(len(self.photos), generator=self.generator).tolist()
            return NextStep(self.stepper.prepare(self.gaussians, state.order.pop(), done), order, random_state)
        except Exception:  # such as out of memory
            self._take_back(order, random_state)
            raise

    def _prepare_ahead(self) -> None:
        """Prepare the next step while a GPU computes this one."""
        if self.ahead is None and self.state.done + 1 < self.settings.steps:
            with suppress(Exception):  # if it persists, it is raised when that step is prepared in its turn
                self.ahead = self._prepare(self.state.done + 1)

    def _undo_ahead(self) -> None:
        """Undo the preparation of the next step,
        so that `order` and the random generator are as the last step left them."""
        if self.ahead is not None:
            self._take_back(self.ahead.order_before, self.ahead.random_state_before)

    def _take_back(self, order: list[int], random_state: Tensor) -> None:
        self.state.order, self.ahead = order, None
        self.generator.set_state(random_state)

    def _forget_gaussians(self) -> None:
        """Drop what depends on the present Gaussians, which are about to change in number or to be replaced."""
        self._undo_ahead()
        self.stepper.forget()

    def change_gaussians(self) -> list[str]:
        """Density control, if it is due; a warning if only the sky is left."""
        if not self.state.change_due:
            return []
        self._forget_gaussians()
        random_state = self.generator.get_state()
        try:
            messages = self.density.change(self.gaussians, self.state)
        except Exception:  # such as out of memory: the checkpoint that is saved then resumes with this
            self.generator.set_state(random_state)
            raise
        self.state.change_due = False
        return messages

    # --- quality, checkpoints

    def held_out_quality(self) -> tuple[float, float] | tuple[None, None]:
        """Mean PSNR (dB) and SSIM of HELD_OUT_PHOTOS test photos; (None, None) without any."""
        background = background_of_figures(self.settings.transparent_is_empty)
        return held_out.quality(self.held_out, self.gaussians, self.model, self.rasterizer, background)

    def save(self) -> Path:
        """Write a checkpoint from which `resume` continues, bit for bit on a CPU."""
        self._undo_ahead()
        parts = {
            "gaussians": self.gaussians.tensors(),
            "model": self.model.state_dict(),
            "optimizer": self.optimizer.tensors(),
            "random": {"generator": self.generator.get_state()},
        }
        if self.state.done == self.settings.steps and len(self.model.met_embeddings):
            on_progress = within_step(self.state.done, "looks", self.settings, self.report)
            embeddings = self.model.encode_training_photos(self._encoder_inputs(on_progress))
            parts["encoded"] = dict(zip(("masked", "unmasked"), embeddings))
        tensors = {f"{part}.{name}": tensor for part, named in parts.items() for name, tensor in named.items()}
        photos = [sized.photo.name for sized in self.photos]
        facts = {"sky": self.gaussians.sky_count, "photos": photos, **self.state.facts()}
        return checkpoint.save(self.folder, checkpoint.Checkpoint(tensors, facts))

    def resume(self, saved: checkpoint.Checkpoint) -> None:
        """Restore the state of a checkpoint; KeyError, TypeError,
        ValueError or RuntimeError if it is of another collection or other settings."""
        state = RunState.of_facts(saved.facts)
        state.check_photos(len(self.photos))
        gaussians = Gaussians.from_tensors(saved.part("gaussians"), saved.facts["sky"])
        if gaussians.kind != self.gaussians.kind:
            raise ValueError(
                "Gaussians of another kind than its settings ask for: "
                f"{gaussians.kind} instead of {self.gaussians.kind}"
            )
        self._forget_gaussians()
        self.gaussians = gaussians.to(self.device)
        self.model.load_state_dict(saved.part("model"))
        self.optimizer.restore(saved.part("optimizer"))
        self.generator.set_state(saved.tensors["random.generator"])
        self.state, self.last_losses = state, guards.LastLosses(state.last_losses)
