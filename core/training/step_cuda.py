"""Training steps on a GPU, recorded as a CUDA graph and replayed.

A step launches some 500 kernels, and for a small scene launching them takes longer than running them. But between two
rounds of density control steps differ in nothing but numbers: all photos lie on one canvas, and there is room for as
many Gaussians as any of them shows. So the kernels of one step are recorded, and replayed with other numbers for the
steps that follow.
"""

import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field

import torch
from torch import Tensor

from core.appearance.model import Reading
from core.errors import as_out_of_memory
from core.rasterizer.cuda.backend import BYTES_PER_PAIR, CudaRasterizer, Room, memory_budget
from core.system.cuda_graph import Recorder, Recording, can_record
from core.system.device import first_line
from core.training import schedule
from core.training.gaussians.gaussians import Gaussians
from core.training.guards import StepFacts
from core.training.losses.canvas import TargetOnCanvas
from core.training.step import InView, Result, StepInputs, Stepper
from core.training.step_context import StepContext

NO_ROOM = Room(-1, -1)  # none was made for the present Gaussians; a view of nothing has Room(0, 0)
MORE_GAUSSIANS, MORE_PAIRS = 1.5, 2.0  # times what one photo shows there is room for: others show more


@dataclass
class StepperOnGpu(Stepper):
    """Takes the same steps as Stepper, and replays recorded ones where `_can_be_replayed`.

    situation: see `_situation`, of the last step. ran: the kinds of steps that ran in this situation, True for those
    with L_regTS (see `Objective.has_transient_loss`), False for those without. The second step of a kind is recorded,
    with inputs of its own, into which the inputs of later steps are copied.
    """

    rasterizer: CudaRasterizer
    situation: tuple = ()
    room: Room = NO_ROOM
    ran: set[bool] = field(default_factory=set)
    recordings: dict[bool, tuple[Recording[tuple[Reading, Tensor]], StepInputs]] = field(default_factory=dict)
    recorder: Recorder | None = None
    records: bool = True  # False once a recording failed, or memory did not suffice beside one

    def forget(self) -> None:
        self.room = NO_ROOM
        self._drop_recordings()

    def _drop_recordings(self) -> None:
        self.ran, self.recordings = set(), {}
        if self.recorder is not None:
            self.recorder.forget()

    def _compute(
        self, gaussians: Gaussians, inputs: StepInputs, context: StepContext, meanwhile: Callable[[], None]
    ) -> tuple[Reading, StepFacts]:
        if not can_record(inputs.encoder_input.device):
            return self._compute_with_room(gaussians, inputs, context, meanwhile)
        self.recorder = self.recorder or Recorder()
        with self.recorder.at_work():
            return self._compute_with_room(gaussians, inputs, context, meanwhile)

    def _compute_with_room(
        self, gaussians: Gaussians, inputs: StepInputs, context: StepContext, meanwhile: Callable[[], None]
    ) -> tuple[Reading, StepFacts]:
        """Take the step, again with more room where there was too little:
        such a step changes nothing but tells how much it needs."""
        situation = self._situation(inputs, context)
        if situation != self.situation:
            self.situation = situation
            self._drop_recordings()
        if self.room == NO_ROOM:
            visible = self.rasterizer.visible(gaussians.splats, context.camera)
            self._make_room(gaussians, len(visible.rows), visible.known.pairs)
        has_transient_loss = self.objective.has_transient_loss(context)
        while True:
            reading, facts = self._replay_or_run(has_transient_loss, gaussians, inputs, context)
            self.ran.add(has_transient_loss)
            meanwhile()
            *numbers, shown, pairs = facts.cpu().tolist()
            if shown <= self.room.gaussians and pairs <= self.room.pairs:
                return reading, StepFacts.of(numbers)
            self._make_room(gaussians, shown, pairs)

    def _situation(self, inputs: StepInputs, context: StepContext) -> tuple:
        """What decides which kernels a step launches, beside the Gaussians and their room."""
        return (
            inputs.encoder_input.shape,
            inputs.target.planes.shape,
            inputs.gain is None,
            schedule.begun(self.settings, context.progress),
        )

    def _make_room(self, gaussians: Gaussians, shown: float, pairs: float) -> None:
        most_pairs = memory_budget(gaussians.counts.device) // BYTES_PER_PAIR
        rows = min(math.ceil(MORE_GAUSSIANS * shown), len(gaussians))
        self.room = Room(rows, int(max(pairs, min(math.ceil(MORE_PAIRS * pairs), most_pairs))))
        self._drop_recordings()

    def _find_visible(self, gaussians: Gaussians, inputs: StepInputs, context: StepContext) -> InView:
        """As many of the Gaussians that the camera shows as there is room for; needed:
        how many Gaussians and pairs it shows in all."""
        _, height, width = inputs.target.planes.shape
        visible, needed = self.rasterizer.visible_within(gaussians.splats, inputs.view, (height, width), self.room)
        shown, pairs = needed.unbind()
        return InView(visible, shown, (shown <= self.room.gaussians) & (pairs <= self.room.pairs), (shown, pairs))

    def _beside(self, work: Callable[[], Result]) -> Callable[[], Result]:
        return super()._beside(work) if self.recorder is None else self.recorder.beside(work)

    def _can_be_replayed(self, inputs: StepInputs) -> bool:
        """Whether only numbers differ between this step and others of its kind in the same situation: not where the
        host chooses rows of a table, nor where photos share no canvas.
        """
        tables = self.model.embedding_table is not None or self.settings.mask == "mlp"
        return self.records and isinstance(inputs.target, TargetOnCanvas) and not tables

    def _replay_or_run(
        self, has_transient_loss: bool, gaussians: Gaussians, inputs: StepInputs, context: StepContext
    ) -> tuple[Reading, Tensor]:
        """Take the step. A recording keeps the memory that it works in: where too little is left beside, or where none
        can be made, this step and all later ones are run. What is wrong with the step itself, it raises then."""
        recorder = self.recorder if has_transient_loss in self.ran and self._can_be_replayed(inputs) else None
        try:
            if recorder is None:
                return self._learn(gaussians, inputs, context)
            return self._replay(recorder, has_transient_loss, gaussians, inputs, context)
        except RuntimeError as problem:  # torch's own for too little memory, or CUDA's
            recording_failed = recorder is not None and has_transient_loss not in self.recordings
            if not recording_failed and (as_out_of_memory(problem) is None or not self.recordings):
                raise
            why = f"their kernels can't be launched as one ({first_line(problem)})"
            self.messages.append(f"Steps take longer from here on: {why}")
        # Not above: until its handler ends, the exception keeps all that the failed attempt made.
        self.records = False
        self._drop_recordings()
        return self._learn(gaussians, inputs, context)

    def _replay(
        self,
        recorder: Recorder,
        has_transient_loss: bool,
        gaussians: Gaussians,
        inputs: StepInputs,
        context: StepContext,
    ) -> tuple[Reading, Tensor]:
        if has_transient_loss not in self.recordings:
            own = deepcopy(inputs)
            self.recordings[has_transient_loss] = recorder.record(lambda: self._learn(gaussians, own, context)), own
        recording, own = self.recordings[has_transient_loss]
        copies: dict[torch.dtype, list[tuple[Tensor, Tensor]]] = {}
        for pair in zip(own.tensors, inputs.tensors, strict=True):
            copies.setdefault(pair[0].dtype, []).append(pair)
        for pairs in copies.values():  # one launch for each type
            targets, sources = zip(*pairs)
            torch._foreach_copy_(targets, sources)
        return recording.replay()
