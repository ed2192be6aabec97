"""What keeps the base harmonics at the neutral look: how a residual is weighed."""

import torch

from core.training.losses.gauge import draw_rows, gauge


def test_the_gauge_is_the_mean_over_gaussians_of_the_squared_residual(trainer_of, monkeypatch):
    trainer, asked = trainer_of(latent_size=3), []
    gaussians, neutral = trainer.gaussians, torch.rand(trainer.settings.embedding_size)
    gaussians.latents.normal_()
    monkeypatch.setattr(
        trainer.model.sh_transfer, "forward", lambda *call: asked.append(call) or torch.full_like(call[0].sh, 3.0)
    )
    rows = draw_rows(gaussians, trainer.generator)
    assert float(gauge(trainer.model.sh_transfer, gaussians, rows, neutral)) == 4 * 3 * 3.0**2
    ((base, embedding),) = asked
    wanted = gaussians.splats.sh[rows], gaussians.splats.means[rows], gaussians.latents[rows], neutral
    assert all(map(torch.equal, (base.sh, base.means, base.latents, embedding), wanted))
