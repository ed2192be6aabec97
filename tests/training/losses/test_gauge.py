"""What keeps the base harmonics at the neutral look: how a residual is weighed."""

import torch

from core.training.losses.gauge import draw_rows, gauge


def test_the_gauge_is_the_mean_over_gaussians_of_the_squared_residual(trainer_of, monkeypatch):
    trainer = trainer_of()
    monkeypatch.setattr(trainer.model.sh_transfer, "forward", lambda sh, *_: torch.full_like(sh, 2.0))
    rows = draw_rows(trainer.gaussians, trainer.generator)
    assert float(gauge(trainer.model.sh_transfer, trainer.gaussians, rows, trainer.model.mean_embedding)) == 4 * 3 * 2.0**2
