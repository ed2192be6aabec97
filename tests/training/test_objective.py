"""What a step minimises: which loss counts from when on, by what weight, and whom it reaches."""

from dataclasses import replace

import pytest
import torch

from core.appearance.model import Look
from core.training import losses
from core.training.photometric import photometric_of_mask


def test_a_mask_is_taught_from_its_time_on(trainer_of):
    trainer = trainer_of(mask_start=0.2, mask_apply=0.6)
    drawn = trainer._forward(0, 0.0)
    taught = [float(trainer.objective.mask(drawn, progress).detach()) for progress in (0.0, 0.19, 0.2, 0.9)]
    assert taught[:2] == [0, 0] and taught[2] == taught[3] > 0


def test_the_papers_mask_is_taught_by_the_pictures_error(trainer_of):
    trainer = trainer_of(mask_loss="paper", mask_start=0.0, mask_regularisation=0.5)
    drawn = trainer._forward(0, 0.0)
    mask = drawn.look.mask
    shown = losses.enlarged(mask, *drawn.image.shape[:2])
    expected = photometric_of_mask(drawn.image, drawn.target, shown, trainer.settings.ssim_weight) + 0.5 * ((1 - mask) ** 2).mean()
    torch.testing.assert_close(trainer.objective.mask(drawn, 0.0), expected)


def test_the_masks_own_loss_teaches_the_mask_network(trainer_of):
    """Beside what reaches it by the embedding."""
    trainer = trainer_of(mask_start=0.0, mask_apply=0.0)
    bias = trainer.model.encoder.unet.up_2.bias
    drawn = trainer._forward(0, 0.5)
    drawn.embedding.grad = torch.randn(drawn.embedding.shape, generator=torch.Generator().manual_seed(2))
    (by_embedding,) = torch.autograd.grad(drawn.look.embedding, bias, drawn.embedding.grad, retain_graph=True)
    (by_loss,) = torch.autograd.grad(trainer.objective.mask(drawn, 0.5), bias, retain_graph=True)
    assert float(by_loss.abs()) > 1e-6
    trainer.model.zero_grad()
    trainer._teach_encoder(drawn, trainer.objective.mask(drawn, 0.5))
    torch.testing.assert_close(bias.grad, by_embedding + by_loss)


def test_a_step_hands_the_masks_loss_to_the_encoder(trainer_of, monkeypatch):
    trainer = trainer_of(mask_start=0.0, mask_apply=0.0)
    taught = []
    monkeypatch.setattr(trainer, "_teach_encoder", lambda drawn, mask_loss: taught.append(float(mask_loss.detach())))
    trainer.step()
    assert len(taught) == 1 and taught[0] > 0


@pytest.mark.parametrize("mean, share", [(1.0, 0.1), (0.2, 0.55)])
def test_collapsed_masks_are_raised_in_the_pictures_loss(trainer_of, monkeypatch, mean, share):
    """0.1 is static: by itself, or, as the masks of all photos hide too much, half of what else is hidden shows as well."""
    trainer = trainer_of(mask_start=0.0, mask_apply=0.0, mask_regularisation=0.0, transient_regularisation=0.0)
    hidden = Look(trainer.model.mean_embedding, torch.full((1, 9, 12), 0.1))
    whole = Look(trainer.model.mean_embedding, torch.ones(1, 9, 12))
    trainer.mask_mean = mean
    given = []
    picture = trainer.objective.picture
    monkeypatch.setattr(trainer.objective, "picture", lambda *call: given.append(call) or picture(*call))
    trainer.step()
    (drawn, progress, mask_mean), *_ = given
    assert mask_mean == mean
    looks = (picture(replace(drawn, look=look), progress, mask_mean) for look in (hidden, whole))
    by_mask, unmasked = (float(loss.detach()) for loss in looks)
    assert by_mask == pytest.approx(share * unmasked, rel=1e-3)
