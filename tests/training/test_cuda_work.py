"""What a training step asks of a GPU: how often the host waits for it, and how many kernels it starts."""

import weakref
from contextlib import nullcontext
from importlib import import_module
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
import torch

import core.rasterizer
from core.automatic import AUTO_PIXELS
from core.system import device
from core.system.threads import beside
from core.training.gaussians.gaussians import Gaussians
from core.training.losses.objective import TRANSIENT_EVERY
from core.training.losses.photometric import Target
from core.training.schedule import SHRINK_FACTORS
from core.training.trainer import Trainer
from tests.elsewhere import DEVICE, MixedDevices, elsewhere, kernels, watched
from tests.small import small_collection, small_settings
from tests.training.learned import assert_same, copied, learned

pytest.importorskip("triton", reason="Triton is not installed")
pytestmark = pytest.mark.skipif(
    torch.cuda.is_available(), reason="the kernels are not interpreted where there is a GPU"
)

# Triton's interpreter draws a quarter of the size, one tile, of few Gaussians in a second.
SIZES = {
    "steps": 60,
    "coarse_until": 1.0,
    "max_gaussians": 40,
    "sky_gaussians": 12,
    "held_out_checks": 0,
    "densify_rounds": 0,
}

# Of a step, and of L_regTS, which draws once more every tenth; 356 and 73 as of now.
MOST_LAUNCHES, MORE_FOR_TRANSIENTS = 360, 75
STEPS = 4  # compared with those on a CPU


def trainer_of(folder, changes: dict) -> Trainer:
    """In the middle of a small run, everything on but for the changes."""
    settings = small_settings(**{"mask_start": 0.0, "mask_apply": 0.0, "geometry_from": 0.0, **SIZES, **changes})
    trainer = Trainer(small_collection(folder), settings, folder)
    trainer.state.done = 2 * TRANSIENT_EVERY - 3
    return trainer


@pytest.fixture
def changes(request) -> dict:
    """Of the settings; none unless a test is parametrised with some, indirectly."""
    return getattr(request, "param", {})


@pytest.fixture
def losses_on_cpu(tmp_path, changes) -> list[float]:
    """Asked for before `trainer`, which changes what a GPU is."""
    (folder := tmp_path / "cpu").mkdir()
    trainer = trainer_of(folder, changes)
    return [trainer.step().loss for _ in range(STEPS)]


@pytest.fixture
def trainer(tmp_path, monkeypatch, changes):
    """On DEVICE, by the kernels of a GPU."""
    from core.appearance import positional_encoding_cuda
    from core.rasterizer.cuda.backend import CudaRasterizer
    from core.training.gaussians import adam_cuda, chosen_rows_cuda, density_statistics_cuda
    from core.training.losses import photometric_cuda, residual_cuda

    rasterizer = CudaRasterizer()
    rasterizer.device = DEVICE.type
    monkeypatch.setattr(core.rasterizer, "create", lambda *_: rasterizer)
    monkeypatch.setattr(device, "chosen", lambda *_: DEVICE)
    monkeypatch.setitem(AUTO_PIXELS, DEVICE.type, AUTO_PIXELS["cpu"])
    # torch's list of devices with a fused Adam has CUDA, and not this one.
    monkeypatch.setattr(import_module("torch.optim.adam"), "_device_dtype_check_for_fused", lambda *_, **__: None)
    # The kernels that tensors on a GPU go to.
    monkeypatch.setattr("core.appearance.transfer_mlp.encoded_positions", positional_encoding_cuda.encoded_positions)
    monkeypatch.setattr("core.training.gaussians.gaussians.chosen_rows", chosen_rows_cuda.chosen_rows)
    monkeypatch.setattr(Gaussians, "step", adam_cuda.step)
    monkeypatch.setattr("core.training.gaussians.densify.gather", density_statistics_cuda.gather)
    monkeypatch.setattr("core.training.losses.regularisers.residual_loss", residual_cuda.residual_loss)
    monkeypatch.setattr("core.training.losses.objective.photometric", photometric_cuda.photometric_cuda)
    torch.set_num_threads(1)  # what `elsewhere` does is for one thread
    with elsewhere(), kernels():
        yield trainer_of(tmp_path, changes)


def test_losses_are_those_of_a_cpu(losses_on_cpu, trainer, monkeypatch):
    """On any canvas, and also if there was not enough room at first."""
    monkeypatch.setattr(trainer.photos, "canvas", lambda factor: (17, 20))
    losses = []
    for room in (None, (2, 9), (400, 9), (2, 4000)):
        if room is not None:
            trainer.stepper.room = trainer.stepper.room._replace(gaussians=room[0], pairs=room[1])
        losses.append(trainer.step().loss)
    # Losses of order 0.1 over a hundred pixels of one picture, each good to 1e-6; a few steps of Adam keep that.
    assert losses == pytest.approx(losses_on_cpu, abs=1e-5)
    # Of more, kernels could not count as many as there may be.
    assert trainer.stepper.room.gaussians <= len(trainer.gaussians)


class Again:
    """Stands for a Recorder: where a GPU would replay, it does the work again,
    on the tensors and Python numbers that it was recorded with.

    fault: why no recording can be made. recorded: how many recordings were made. attempt: of the recording that failed,
    what it made.
    """

    fault, recorded, attempt = None, 0, None

    beside = staticmethod(beside)

    def at_work(self):
        return nullcontext()

    def forget(self):
        pass

    def record(self, work):
        if self.fault:
            made = torch.zeros(())
            Again.attempt = weakref.ref(made)
            raise RuntimeError(self.fault)
        Again.recorded += 1
        return SimpleNamespace(replay=work)


@pytest.fixture
def records(monkeypatch):
    """Steps on DEVICE are recorded."""
    from core.training import step_cuda

    monkeypatch.setattr(step_cuda, "can_record", lambda device: True)
    monkeypatch.setattr(step_cuda, "Recorder", Again)
    monkeypatch.setattr(Again, "recorded", 0)
    monkeypatch.setattr(Again, "attempt", None)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"appearance": "off", "transients": "off", "sh_degree": 3, "exposure_jitter": 0.0},
        {"appearance": "exposure", "sky": "none"},
        {"mask": "cnn", "mask_loss": "paper", "embedding_enters": "input", "sh_octaves": 1, "detach_sh": True},
        {"transients": "off", "residual": False, "sh_degree": 0},
    ],
    ids=lambda changes: "-".join(map(str, changes.values())) or "everything",
    indirect=True,
)
@pytest.mark.usefixtures("records")
def test_replayed_steps_differ_in_their_numbers_alone(losses_on_cpu, trainer):
    """What a replayed step has of the recorded one is the same in both."""
    losses = [trainer.step().loss for _ in range(STEPS)]
    assert Again.recorded == 1 and losses == pytest.approx(losses_on_cpu, abs=2e-5)
    trainer.density.prune_at, trainer.state.change_due = {trainer.state.done}, True
    trainer.change_gaussians()
    assert trainer.stepper.room.gaussians < 0 and not trainer.stepper.recordings


@pytest.mark.parametrize(
    "changes", [{"embedding": "glo", "exposure_jitter": 0.0}, {"mask": "mlp"}], ids=["glo", "mlp"], indirect=True
)
@pytest.mark.usefixtures("records")
def test_steps_whose_rows_the_host_chooses_are_not_replayed(losses_on_cpu, trainer):
    assert [trainer.step().loss for _ in range(STEPS)] == pytest.approx(losses_on_cpu, abs=1e-5)
    assert Again.recorded == 0


@pytest.mark.parametrize(
    "fault", ["CUDA error: out of memory", "CUDA error: operation not permitted when stream is capturing\nCompile with"]
)
@pytest.mark.usefixtures("records")
def test_where_a_step_cannot_be_recorded_all_are_run(losses_on_cpu, trainer, monkeypatch, fault):
    """Such as for lack of memory, of which the failed attempt keeps none. The user is told, once."""
    monkeypatch.setattr(Again, "fault", fault)
    honest = trainer.stepper._learn
    freed = []

    def learn(*given):
        freed.append(Again.attempt is None or Again.attempt() is None)
        return honest(*given)

    monkeypatch.setattr(trainer.stepper, "_learn", learn)
    reports = [trainer.step() for _ in range(STEPS)]
    assert [report.loss for report in reports] == pytest.approx(losses_on_cpu, abs=1e-5)
    assert not trainer.stepper.records and Again.attempt is not None and all(freed)
    [told] = [message for report in reports for message in report.messages]
    assert fault.partition("\n")[0] in told and "Compile" not in told


@pytest.mark.usefixtures("records")
def test_where_memory_does_not_suffice_beside_a_recording_all_steps_are_run(losses_on_cpu, trainer, monkeypatch):
    """Such as for the first step of another kind."""
    stepper, honest = trainer.stepper, trainer.stepper._learn

    def learn(gaussians, inputs, context):
        if stepper.recordings and stepper.objective.has_transient_loss(context):
            raise torch.OutOfMemoryError("CUDA out of memory.")
        return honest(gaussians, inputs, context)

    monkeypatch.setattr(stepper, "_learn", learn)
    assert [trainer.step().loss for _ in range(STEPS)] == pytest.approx(losses_on_cpu, abs=2e-5)
    assert Again.recorded == 1 and not stepper.records and not stepper.recordings
    monkeypatch.setattr(stepper, "_learn", Mock(side_effect=torch.OutOfMemoryError("CUDA out of memory.")))
    with pytest.raises(torch.OutOfMemoryError):
        trainer.step()
    assert stepper._learn.call_count == 1  # where nothing is recorded, nothing could be gained


@pytest.mark.parametrize(
    ("changes", "shared"),
    [({}, True), ({"transparency": "empty", "sky": "none"}, False)],
    ids=["unseen", "empty"],
    indirect=["changes"],
)
def test_photos_share_a_canvas_unless_transparency_means_empty_space(trainer, shared):
    assert (trainer.photos.canvas(1) is not None) == shared


def test_a_step_waits_once(trainer):
    """It waits at its end, for its facts; so does a step that begins a new round through the photos."""
    for index in range(len(trainer.photos)):
        trainer.photos.target(index, SHRINK_FACTORS[0])  # kept from here on, as are tables after the first step
    trainer.step()
    for _ in range(len(trainer.photos) + 2):
        most = MOST_LAUNCHES + (0 if trainer.state.done % TRANSIENT_EVERY else MORE_FOR_TRANSIENTS)
        with watched() as work:
            trainer.step()
        assert len(work.waits) == 1 and not work.asked, work.waits
        assert sum(work.launches.values()) <= most


def test_a_step_that_shows_nothing_waits_once(trainer):
    """Its room is for nothing, and that is made once, as any other."""
    trainer.gaussians.parameters["logit_opacities"].fill_(-20)
    trainer.step()
    trainer.photos.target(trainer.state.order[-1], SHRINK_FACTORS[0])
    with watched() as work:
        trainer.step()
    assert len(work.waits) == 1, work.waits


def test_an_invalid_step_is_skipped_by_the_gpu_itself(trainer, monkeypatch):
    """The host, which does not look before the step is over, reports and counts it as on a CPU; it leaves no trace."""
    trainer.step()
    before = copied(learned(trainer))
    honest = trainer.objective.picture
    monkeypatch.setattr(trainer.objective, "picture", lambda *arguments: honest(*arguments) * torch.nan)
    (message,) = trainer.step().messages
    assert message.startswith("Step 19 was skipped: its loss was not finite") and trainer.state.skipped == 1
    assert_same(learned(trainer), before)
    monkeypatch.setattr(trainer.objective, "picture", honest)
    assert trainer.step().messages == ()


def test_a_kernel_that_is_given_a_tensor_left_behind_is_found():
    from core.appearance.positional_encoding_cuda import encoded_positions

    with elsewhere(), kernels():
        assert encoded_positions(torch.rand(2, 3).to(DEVICE), 1).device == DEVICE
        with pytest.raises(MixedDevices, match="encode_positions got .* on the CPU"):
            encoded_positions(torch.rand(2, 3), 1)


def test_a_photo_is_laid_over_a_colour_without_waiting():
    with elsewhere(), watched() as work:
        picture = torch.rand(12, 12, 3)
        target = Target(picture.to(DEVICE), empty=picture.amin(dim=2).to(DEVICE))
        before = len(work.waits)
        target.over((0.2, 0.9, 0.5))
        assert len(work.waits) == before > 0


def test_what_waits_is_seen():
    """Else the counts of the other tests would prove nothing."""
    with elsewhere(), watched() as work:
        there = torch.zeros(3, device=DEVICE)
        for wait in (
            lambda: float(there.sum()),
            lambda: torch.nonzero(there),
            lambda: there[there > 0],
            lambda: there.cpu(),
            lambda: torch.ones(2).to(DEVICE),
        ):
            before = len(work.waits)
            wait()
            assert len(work.waits) == before + 1
        there.to("cpu", non_blocking=True)
        device.sent(torch.ones(3), DEVICE)
        assert len(work.waits) == before + 1 and len(work.asked) == 1
        there.cpu()
        assert not work.asked  # what was asked for is there, now that the host has waited for something later


@pytest.mark.usefixtures("records")
def test_what_was_prepared_ahead_leaves_no_trace_in_what_is_saved(trainer):
    """A checkpoint does not depend on the step that was prepared ahead;
    a preparation that fails ahead fails again in its turn."""
    trainer.step()
    assert trainer.ahead is not None
    order, random_state = list(trainer.ahead.order_before), trainer.ahead.random_state_before
    trainer.save()
    assert (
        trainer.ahead is None
        and trainer.state.order == order
        and torch.equal(trainer.generator.get_state(), random_state)
    )

    trainer.step()
    order, honest = list(trainer.state.order), trainer.stepper.prepare

    def fails(*_):
        trainer.generator.manual_seed(7)
        raise torch.OutOfMemoryError

    trainer.stepper.prepare = fails
    trainer.step()  # it was prepared ahead; the next one is not
    random_state = trainer.generator.get_state()
    with pytest.raises(torch.OutOfMemoryError):
        trainer.step()
    assert trainer.state.order == order and torch.equal(trainer.generator.get_state(), random_state)
    trainer.stepper.prepare = honest
    trainer.step()
