"""What a step minimises: which loss counts, from when on, how much, and what it teaches."""

import pytest
import torch

from core.rasterizer.view import view_of
from core.training.gaussians import densify
from core.training.losses import regularisers
from core.training.losses.objective import TRANSIENT_EVERY
from core.training.losses.photometric import Target, photometric, photometric_of_mask, photometric_paper
from tests.training.step_contexts import context_at


def recorded(monkeypatch, owner, name: str) -> list[tuple]:
    """What a method is given from here on, call by call."""
    given, honest = [], getattr(owner, name)
    monkeypatch.setattr(owner, name, lambda *call: given.append(call) or honest(*call))
    return given


def shown(trainer) -> tuple[torch.Tensor, Target, torch.Tensor]:
    """A grey picture, a photo, and its mask."""
    target = trainer.photos.target(0, 1)[1]
    return (
        torch.full((*target.planes.shape[1:], 3), 0.4),
        target,
        trainer.model.read(trainer.photos[0].encoder_input, 0).mask,
    )


def test_a_step_tells_the_sum_of_all_losses_and_gathers_gradients_in_halves_of_its_picture(trainer_of, monkeypatch):
    trainer = trainer_of(steps=90, coarse_until=1.0, mask_start=0.0, mask_apply=0.0, transient_regularisation=1e-4)
    torch.nn.init.constant_(trainer.model.encoder.unet.up_2.bias, -5.0)  # masks that hide
    trainer.gaussians.parameters["logit_opacities"].zero_()
    trainer.state.done = 2 * TRANSIENT_EVERY - 1
    trainer.step()  # until which residuals are zero
    losses = {}

    def kept(name, honest):
        def loss_of(*call):
            found = honest(*call)
            losses[name] = float((found.loss if name == "residual" else found).detach())
            return found

        return loss_of

    for name in ("picture", "transient", "residual", "mask", "gauge"):
        monkeypatch.setattr(trainer.objective, name, kept(name, getattr(trainer.objective, name)))
    drawn, gathered = recorded(monkeypatch, trainer.rasterizer, "render"), recorded(monkeypatch, densify, "gather")
    told = trainer.step().loss
    assert told == pytest.approx(sum(losses.values()), rel=1e-6) and min(losses.values()) > 1e-4 * told
    camera = drawn[0][1]
    assert gathered[0][3].tolist() == [camera.width / 2, camera.height / 2]


def test_masks_are_taught_from_mask_start_on(trainer_of):
    trainer = trainer_of(mask_start=0.2, mask_apply=0.6)
    taught = [
        float(trainer.objective.mask(*shown(trainer), context_at(trainer, progress)).detach())
        for progress in (0.0, 0.19, 0.2, 0.9)
    ]
    assert taught[:2] == [0, 0] and taught[2] == taught[3] > 0


def test_the_papers_mask_hides_as_in_the_paper_and_is_taught_by_the_pictures_error(trainer_of):
    trainer = trainer_of(mask_loss="paper", mask_start=0.0, mask_apply=0.5, mask_regularisation=0.5)
    (image, target, _), objective, ssim_weight = shown(trainer), trainer.objective, trainer.settings.ssim_weight
    mask = torch.rand(1, 9, 12, generator=torch.Generator().manual_seed(0))
    expected = photometric_of_mask(image, target, target.to_pixels(mask), ssim_weight) + 0.5 * ((1 - mask) ** 2).mean()
    torch.testing.assert_close(objective.mask(image, target, mask, context_at(trainer, 0.0)), expected)
    contexts = (context_at(trainer, progress) for progress in (0.49, 0.5))
    whole, hidden = (objective.picture(image, target, mask, context, torch.tensor(1.0)) for context in contexts)
    torch.testing.assert_close(hidden, photometric_paper(image, target, target.to_pixels(mask), ssim_weight))
    torch.testing.assert_close(whole, photometric(image, target, None, ssim_weight))


def test_the_masks_own_loss_teaches_the_mask_network(trainer_of, monkeypatch):
    """In addition to the gradient that reaches it through the embedding."""
    trainer = trainer_of(mask_start=0.0, mask_apply=0.0)
    bias = trainer.model.encoder.unet.up_2.bias
    readings, transfers = (recorded(monkeypatch, trainer.model, name) for name in ("read", "transfer"))
    masks = recorded(monkeypatch, trainer.objective, "mask")
    monkeypatch.setattr(trainer.optimizer, "step", lambda *_: None)
    picture = trainer.objective.picture  # made to weigh so much that both show in the sum
    monkeypatch.setattr(trainer.objective, "picture", lambda *call: 1e3 * picture(*call))
    trainer.step()
    look = trainer.model.read(*readings[0])
    (embedding,) = (embedding for _, embedding in transfers if embedding.requires_grad)  # the gauge's does not
    (by_embedding,) = torch.autograd.grad(look.embedding, bias, embedding.grad, retain_graph=True)
    ((image, target, _, context),) = masks
    (by_loss,) = torch.autograd.grad(trainer.objective.mask(image, target, look.mask, context), bias)
    assert min(float(by_loss.abs()), float(by_embedding.abs())) > 1e-5
    torch.testing.assert_close(bias.grad, by_embedding + by_loss, rtol=1e-4, atol=0)


@pytest.mark.parametrize("mean, share", [(1.0, 0.1), (0.2, 0.55)])
def test_collapsed_masks_are_raised_in_the_pictures_loss(trainer_of, monkeypatch, mean, share):
    """The mask is 0.1 everywhere: it weighs 0.1, or more if the masks of all photos hide too much,
    as half of what is hidden counts then."""
    trainer = trainer_of(mask_start=0.0, mask_apply=0.0, mask_regularisation=0.0, transient_regularisation=0.0)
    trainer.state.mask_mean = mean
    given = recorded(monkeypatch, trainer.objective, "picture")
    trainer.step()
    ((image, target, _, *rest),) = given
    assert float(rest[1]) == pytest.approx(mean)
    hidden, whole = torch.full((1, 9, 12), 0.1), torch.ones(1, 9, 12)
    by_mask, unmasked = (
        float(trainer.objective.picture(image, target, mask, *rest).detach()) for mask in (hidden, whole)
    )
    assert by_mask == pytest.approx(share * unmasked, rel=1e-3)


def test_passers_by_are_faded_by_the_weight_that_is_set_once_masks_are_applied(trainer_of):
    trainer = trainer_of(mask_start=0.2, mask_apply=0.6, transient_regularisation=1e-3)
    trainer.gaussians.parameters["logit_opacities"].zero_()
    camera, splats, mask = trainer.photos[0].camera, trainer.gaussians.splats, torch.zeros(1, 9, 12)
    visible = trainer.rasterizer.visible(splats, camera)
    splats = splats[visible.rows]
    front = trainer.rasterizer.contributions(splats, camera)
    view = view_of(camera)
    rows = regularisers.transient_rows(splats.means, front, mask, view)
    opacity = torch.sigmoid(splats.logit_opacities[rows]).sum()
    assert opacity > 1

    def mean_of_twenty_steps(progress):
        found = []
        for done in range(1, 21):
            found.append(
                float(
                    trainer.objective.transient(
                        splats, view, visible.known, mask, context_at(trainer, progress, done)
                    ).detach()
                )
            )
        return sum(found) / 20

    assert [mean_of_twenty_steps(progress) for progress in (0.0, 0.3, 0.59)] == [0, 0, 0]
    for progress in (0.6, 1.0):
        assert mean_of_twenty_steps(progress) == pytest.approx(1e-3 * float(opacity), rel=1e-5)
