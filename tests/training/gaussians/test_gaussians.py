"""Which parameters of the Gaussians learn, from when on, and how fast."""

import pytest
import torch

from core.training import network_updates
from core.training.gaussians.gaussians import learning_rates
from tests.small import small_settings
from tests.training.conftest import RATES
from wegs_cli.options import settings_from


def test_new_gaussians_start_without_history_and_do_not_change_the_others(gaussians):
    for name, tensor in gaussians.tensors().items():
        if not name.startswith("parameters"):
            tensor.fill_(1)
    solid, born = gaussians.solid_count, {name: tensor[:3].clone() for name, tensor in gaussians.parameters.items()}
    gaussians.insert(born)
    for name, tensor in gaussians.tensors().items():
        if not name.startswith("parameters"):
            assert tensor[:solid].all() and not tensor[solid : solid + 3].any() and tensor[solid + 3 :].all(), name


def test_before_geometry_from_only_harmonics_learn(trainer_of):
    trainer = trainer_of(steps=10, geometry_from=0.5)
    before = {name: tensor.clone() for name, tensor in trainer.gaussians.parameters.items()}
    for step in range(1, 11):
        trainer.step()
        moved = {name for name, tensor in trainer.gaussians.parameters.items() if not torch.equal(tensor, before[name])}
        # The first step makes ellipsoids of spheres, whose turns no picture shows.
        assert moved == ({"sh"} if step <= 5 else set(before) - ({"quaternions"} if step == 6 else set())), step


def test_gaussians_learn_at_the_rates_that_are_set_bands_above_dc_at_a_twentieth():
    rates = learning_rates(small_settings(latent_size=3, latents_from=0.0, geometry_from=0.0, **RATES), 0.0)
    for name, expected in {
        "means": [0.1] * 3,
        "quaternions": [0.2] * 4,
        "log_scales": [0.3] * 3,
        "logit_opacities": [0.4],
        "sh": [0.5] * 3 + [0.025] * 9,
        "latents": [0.6] * 3,
    }.items():
        assert rates.pop(name).tolist() == pytest.approx(expected), name
    assert not rates


def test_a_learning_rate_given_as_a_whole_number_becomes_a_float(tmp_path):
    """A file of settings may give one; with whole numbers, kernels would be compiled again, and round differently."""
    (tmp_path / "x.toml").write_text("".join(f"{name} = 1\n" for name in RATES))
    settings = settings_from("paper", tmp_path / "x.toml", (), {})
    assert {rates.dtype for rates in learning_rates(settings, 0.5).values()} == {torch.float32}
    assert all(type(getattr(settings, name)) is float for name in RATES)


def test_centres_slow_down_to_a_hundredth_networks_and_latents_to_a_tenth(trainer_of, monkeypatch):
    trainer = trainer_of(latent_size=3, latents_from=0.0, geometry_from=0.0, **RATES)
    used, given, slowed = [], [], {"means": 0.01, "latents": 0.1}
    monkeypatch.setattr(trainer.optimizer, "step", lambda rates, _: given.extend(rates))
    for progress in (0.0, 0.5, 1.0):
        used.append(learning_rates(trainer.settings, progress))
        for name, rates in used[-1].items():
            torch.testing.assert_close(rates, used[0][name] * slowed.get(name, 1.0) ** progress)
        given.clear()
        network_updates.update(
            trainer.optimizer, network_updates.rates_at(trainer.optimizer, progress), torch.tensor(True)
        )
        assert given == pytest.approx([rate * 0.1**progress for rate in trainer.optimizer.rates])
    assert used[0]["means"].tolist() == pytest.approx([0.1] * 3)
    assert used[0]["latents"].tolist() == pytest.approx([0.6] * 3)
