"""What a step learns, and how fast; what is shown of it on the way."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from core.appearance.model import AppearanceModel
from core.scene.harmonics import dc_of_colour
from core.training import network_updates
from core.training.gaussians.gaussians import learning_rates
from core.training.jitter import draw_gain, jittered
from core.training.losses import regularisers
from core.training.losses.gauge import Gauge
from core.training.losses.photometric import Target
from core.training.on_disk.mask_files import write_masks
from tests.small import small_settings

PHOTOS = ["a.jpg", "b.jpg"]


# --- what


def test_until_its_time_the_geometry_stays_and_only_harmonics_learn(trainer_of):
    trainer = trainer_of(steps=10, geometry_from=0.5)
    before = {name: tensor.clone() for name, tensor in trainer.gaussians.parameters.items()}
    for step in range(1, 11):
        trainer.step()
        moved = {name for name, tensor in trainer.gaussians.parameters.items() if not torch.equal(tensor, before[name])}
        assert moved == ({"sh"} if step <= 5 else set(before)), step


def test_the_budget_grows_from_a_quarter_of_the_cap_to_all_of_it(trainer_of):
    trainer = trainer_of(steps=40, densify_rounds=4, max_gaussians=600)
    rounds = sorted(trainer.grow_at)
    for number, step in enumerate(rounds, 1):
        trainer.done = step
        trainer.gaussians.gradient_sum.fill_(1.0)
        trainer.gaussians.seen.fill_(1.0)
        trainer.control_density()
        assert trainer.gaussians.solid <= round(600 * (0.25 + 0.75 * number / len(rounds))), number
    assert trainer.gaussians.solid == 600


def test_passers_by_are_faded_by_the_weight_that_is_set_once_masks_are_applied(trainer_of):
    trainer = trainer_of(mask_start=0.2, mask_apply=0.6, transient_regularisation=1e-3)
    trainer.gaussians.parameters["logit_opacities"].zero_()
    camera, splats, mask = trainer.photos[0].camera, trainer.gaussians.splats, torch.zeros(1, 9, 12)
    visible = trainer.rasterizer.visible(splats, camera)
    splats = splats[visible.rows]
    front = trainer.rasterizer.contributions(splats, camera)
    rows = regularisers.transient_rows(splats.means, front, mask, camera)
    opacity = torch.sigmoid(splats.logit_opacities[rows]).sum()
    assert opacity > 1

    def mean_of_twenty_steps(progress):
        found = []
        for step in range(1, 21):
            found.append(float(trainer.objective.transient(splats, camera, visible.known, mask, progress, step).detach()))
        return sum(found) / 20

    assert [mean_of_twenty_steps(progress) for progress in (0.0, 0.3, 0.59)] == [0, 0, 0]
    for progress in (0.6, 1.0):
        assert mean_of_twenty_steps(progress) == pytest.approx(1e-3 * float(opacity), rel=1e-5)


def test_the_gauge_is_the_mean_over_gaussians_of_the_squared_residual(trainer_of, monkeypatch):
    trainer = trainer_of()
    monkeypatch.setattr(trainer.model.sh_transfer, "forward", lambda sh, *_: torch.full_like(sh, 2.0))
    assert float(Gauge(trainer.model)(trainer.gaussians, trainer.generator)) == 4 * 3 * 2.0**2


def test_gains_stop_at_their_largest_and_the_encoder_is_shown_nothing_above_one():
    generator, settings = torch.Generator().manual_seed(0), small_settings(exposure_jitter=1.0)
    gains = torch.stack([draw_gain(settings, generator) for _ in range(200)])
    assert gains.max() == torch.tensor(1.4) and gains.min() < 0.2
    photo, gain = torch.rand(3, 12, 16), torch.tensor([1.4, 1.0, 0.5])
    shown, target = jittered(photo, Target(photo.permute(1, 2, 0)), gain)
    brightened = photo * gain[:, None, None]
    assert brightened.max() > 1.2
    torch.testing.assert_close(target.planes, brightened)
    torch.testing.assert_close(shown, brightened.clamp(max=1))


# --- how fast


RATES = {
    "mean_rate": 0.1,
    "quaternion_rate": 0.2,
    "scale_rate": 0.3,
    "opacity_rate": 0.4,
    "sh_rate": 0.5,
    "embedding_rate": 0.6,
    "network_rate": 0.7,
    "encoder_rate": 0.8,
}


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


@pytest.mark.parametrize(
    "changes, expected",
    [
        ({}, {"encoder.enc": 0.8, "encoder.channel_attention": 0.8, "encoder.unet": 0.7, "sh_transfer": 0.7}),
        ({"embedding": "glo", "mask": "mlp"}, {"embedding_table": 0.6, "mask_network": 0.7, "sh_transfer": 0.7}),
    ],
    ids=["encoder", "tables"],
)
def test_every_network_learns_at_its_own_rate(changes, expected):
    settings = small_settings(**RATES, **changes)
    model = AppearanceModel(settings, PHOTOS)
    groups = network_updates.optimizer_of(model, settings).param_groups
    rates = {weight: group["rate"] for group in groups for weight in group["params"]}
    for name, weight in model.named_parameters():
        (rate,) = (rate for part, rate in expected.items() if name.startswith(part))
        assert rates.pop(weight) == rate, name
    assert not rates


def test_centres_slow_down_to_a_hundredth_networks_and_latents_to_a_tenth(trainer_of):
    trainer = trainer_of(latent_size=3, latents_from=0.0, geometry_from=0.0, **RATES)
    used, slowed = [], {"means": 0.01, "latents": 0.1}
    for progress in (0.0, 0.5, 1.0):
        used.append(learning_rates(trainer.settings, progress))
        for name, rates in used[-1].items():
            torch.testing.assert_close(rates, used[0][name] * slowed.get(name, 1.0) ** progress)
        network_updates.update(trainer.optimizer, progress, torch.tensor(True))
        for group in trainer.optimizer.param_groups:
            assert group["lr"] == pytest.approx(group["rate"] * 0.1**progress)
    assert used[0]["means"].tolist() == pytest.approx([0.1] * 3)
    assert used[0]["latents"].tolist() == pytest.approx([0.6] * 3)


# --- what is shown of it


def test_every_photo_is_written_with_its_own_mask(trainer_of, tmp_path):
    trainer = trainer_of(mask="mlp")
    torch.nn.init.normal_(trainer.model.mask_network.last.weight, std=0.2)
    torch.nn.init.zeros_(trainer.model.mask_network.last.bias)
    assert write_masks(tmp_path, trainer.model, trainer.photos) == 4
    for index, sized in enumerate(trainer.photos):
        written = cv2.imread(str(tmp_path / "masks" / sized.photo.name), cv2.IMREAD_GRAYSCALE)
        mask = trainer.model.read(sized.encoder_input, index).mask[0].detach().numpy()
        expected = cv2.resize(mask, written.shape[::-1]) * 255
        assert np.abs(written - expected).max() <= 1.5
    assert len({path.read_bytes() for path in (tmp_path / "masks").iterdir()}) == 4


def test_held_out_renders_are_judged_as_they_are_shown(trainer_of):
    """Three times as bright as white is white."""
    trainer = trainer_of(appearance="off", transients="off")
    white = [replace(sized, pixels=np.full_like(sized.pixels, 255)) for sized in trainer.held_out]
    trainer.held_out.photos[:] = white
    trainer.gaussians.parameters["sh"][:, 0] = float(dc_of_colour(torch.tensor(3.0)))
    psnr, ssim = trainer.held_out_quality()
    assert psnr > 60 and ssim > 0.999
    # What a photo does not show is not compared.
    seen = np.arange(white[0].pixels.shape[1]) >= 20
    half = [replace(sized, pixels=sized.pixels * seen[:, None].astype(np.uint8), valid=np.tile(seen, (len(sized.pixels), 1))) for sized in white]
    trainer.held_out.photos[:] = half
    assert trainer.held_out_quality() == pytest.approx((psnr, ssim), abs=1e-3)
