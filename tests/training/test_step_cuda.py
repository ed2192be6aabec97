"""Steps that are replayed are the steps themselves.
What they compute is compared with a CPU in test_cuda_run and test_cuda_work."""

import pytest
import torch

from core.training.losses.objective import TRANSIENT_EVERY
from core.training.trainer import Trainer
from tests.small import small_collection, small_settings

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU to record anything on")

STEPS = 60


def run(folder, monkeypatch, recorded: bool) -> tuple[list[float], int, int]:
    """Losses, how many steps were replayed, and how many Gaussians there are after a run through all its parts,
    with growth and pruning."""
    from core.training import step_cuda

    (folder := folder / str(recorded)).mkdir()
    settings = small_settings(
        steps=STEPS, mask_start=0.3, mask_apply=0.5, held_out_checks=3, densify_rounds=2, device="cuda"
    )
    trainer, replayed = Trainer(small_collection(folder), settings, folder), []
    honest = step_cuda.StepperOnGpu._replay
    with monkeypatch.context() as patch:
        patch.setattr(step_cuda, "can_record", lambda device: recorded)
        patch.setattr(step_cuda.StepperOnGpu, "_replay", lambda *given: replayed.append(1) or honest(*given))
        return [report.loss for report in trainer.train()], len(replayed), len(trainer.gaussians)


def test_a_replayed_run_is_the_run(tmp_path, monkeypatch):
    losses, replayed, count = run(tmp_path, monkeypatch, True)
    expected_losses, none, expected_count = run(tmp_path, monkeypatch, False)
    assert none == 0 and replayed > STEPS * (1 - 1 / TRANSIENT_EVERY) / 2
    # The library of convolutions may choose another algorithm: the runs are the same but for rounding, which grows.
    assert losses[: STEPS // 3] == pytest.approx(expected_losses[: STEPS // 3], rel=1e-3)
    assert losses == pytest.approx(expected_losses, rel=0.1) and count == pytest.approx(expected_count, rel=0.1)
