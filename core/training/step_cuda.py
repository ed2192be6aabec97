"""Training steps on a GPU, which is told of a whole step at once.

A step starts some 250 kernels, which takes the host longer than the GPU needs for those of a small scene. But between two rounds of density
control steps differ in nothing but numbers: photos lie on one canvas, and there is room for as many Gaussians as any of them shows. So the kernels
of one step are recorded, and replayed with other numbers for those that follow.
"""

import math
from copy import deepcopy
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from core.appearance.model import Reading
from core.rasterizer.cuda.backend import Room
from core.rasterizer.cuda.view import view_of
from core.system.cuda_graph import Recorder, Recording, can_record
from core.system.device import sent
from core.training import schedule
from core.training.gaussians.gaussians import Gaussians
from core.training.guards import StepFacts
from core.training.losses.canvas import TargetOnCanvas
from core.training.step import Moment, StepInputs, Stepper

MORE_GAUSSIANS, MORE_PAIRS = 1.5, 2.0  # than one photo shows there is room for: others show more


@dataclass
class StepperOnGpu(Stepper):
    """Takes the steps of Stepper, and replays those that were recorded.

    situation: of the last step; `kept`: its Gaussians. ran: the kinds of steps that were taken in it with this `room`: those that look at who
    stands at the front, and those that do not. The next of such a kind is recorded, with the inputs that those of others are copied into.
    """

    situation: tuple = ()
    kept: dict[str, Tensor] | None = None
    room: Room | None = None
    ran: set[bool] = field(default_factory=set)
    recordings: dict[bool, tuple[Recording[tuple[Reading, Tensor]], StepInputs]] = field(default_factory=dict)
    recorder: Recorder | None = None

    def _taken(self, gaussians: Gaussians, inputs: StepInputs, moment: Moment) -> tuple[Reading, StepFacts]:
        if not can_record(inputs.encoder_input.device):
            return self._fitting(gaussians, inputs, moment)
        self.recorder = self.recorder or Recorder()
        with self.recorder.at_work():
            return self._fitting(gaussians, inputs, moment)

    def _fitting(self, gaussians: Gaussians, inputs: StepInputs, moment: Moment) -> tuple[Reading, StepFacts]:
        """The step, with as much room as it needs: with too little it is not taken, but tells how much that is."""
        inputs = replace(inputs, view=sent(view_of(moment.camera), inputs.encoder_input.device))
        situation = self._situation(gaussians, inputs, moment)
        if situation != self.situation:
            self.situation, self.kept = situation, gaussians.parameters
            visible = self.rasterizer.visible(gaussians.splats, moment.camera)
            self._make_room(inputs, len(visible.rows), visible.known.pairs)
        kind = self.objective.looks_at_front(moment.progress, moment.done)
        while True:
            if kind in self.ran and self._can_be_replayed(inputs):
                reading, facts = self._replay(kind, gaussians, inputs, moment)
            else:
                reading, facts = self._run(gaussians, inputs, moment)
            self.ran.add(kind)
            *facts, shown, pairs = facts.cpu().tolist()
            if shown <= self.room.gaussians and pairs <= self.room.pairs:
                return reading, StepFacts(*facts)
            self._make_room(inputs, shown, pairs)

    def _situation(self, gaussians: Gaussians, inputs: StepInputs, moment: Moment) -> tuple:
        """What decides which kernels a step starts, on which memory. The Gaussians are `kept` so that no others come to have their id."""
        sizes = inputs.encoder_input.shape, inputs.target.planes.shape
        return id(gaussians.parameters), *sizes, inputs.gain is None, schedule.begun(self.settings, moment.progress)

    def _make_room(self, inputs: StepInputs, shown: float, pairs: float) -> None:
        height, width = inputs.target.planes.shape[1:]
        self.room = Room(width, height, math.ceil(MORE_GAUSSIANS * shown), math.ceil(MORE_PAIRS * pairs))
        self.ran, self.recordings = set(), {}

    def _run(self, gaussians: Gaussians, inputs: StepInputs, moment: Moment) -> tuple[Reading, Tensor]:
        """The step, and its facts, behind which it says how much room it needs."""
        visible, needed = self.rasterizer.visible_within(gaussians.splats, inputs.view, self.room)
        fits = (needed[0] <= self.room.gaussians) & (needed[1] <= self.room.pairs)
        inputs = replace(inputs, largest_loss=torch.where(fits, inputs.largest_loss, -math.inf))
        reading, facts = self._learn(gaussians, inputs, moment, lambda: (visible, needed[0]))
        return reading, torch.cat([facts, needed.double()])

    def _can_be_replayed(self, inputs: StepInputs) -> bool:
        """Whether nothing but numbers differs between this step and another of its kind in the same situation."""
        tables = self.model.embedding_table is not None or self.settings.mask == "mlp"  # rows are chosen by the host
        return self.recorder is not None and isinstance(inputs.target, TargetOnCanvas) and not tables

    def _replay(self, kind: bool, gaussians: Gaussians, inputs: StepInputs, moment: Moment) -> tuple[Reading, Tensor]:
        if kind not in self.recordings:
            own = deepcopy(inputs)
            self.recordings[kind] = self.recorder.record(lambda: self._run(gaussians, own, moment)), own
        recording, own = self.recordings[kind]
        for into, out_of in zip(_by_type(own), _by_type(inputs), strict=True):
            torch._foreach_copy_(into, out_of)
        return recording.replay()


def _by_type(inputs: StepInputs) -> tuple[list[Tensor], list[Tensor]]:
    """All tensors of the inputs: those of float32, which are copied at once, and the others."""
    target, rates = inputs.target.tensors, inputs.rates.values()
    given = inputs.encoder_input, *target, inputs.view, inputs.half_size, inputs.largest_loss, inputs.mask_mean, *rates, *inputs.network_rates
    given = [tensor for tensor in (*given, inputs.camera, inputs.neutral, inputs.gain, inputs.gauge_rows) if tensor is not None]
    return [each for each in given if each.dtype == torch.float32], [each for each in given if each.dtype != torch.float32]
