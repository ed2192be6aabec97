"""How the networks learn: each at its own rate,
and the encoder as soon as the embedding has its gradient, or at the end."""

import pytest
import torch

from core.appearance.model import AppearanceModel
from core.system.threads import beside
from core.training import network_updates
from core.training.losses.backward import backward
from tests.small import small_settings
from tests.training.conftest import RATES

PHOTOS = ["a.jpg", "b.jpg"]


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
    optimizer = network_updates.optimizer_of(model, settings)
    rates = {each.weight: rate for rate, group in zip(optimizer.rates, optimizer.groups) for each in group}
    for name, weight in model.named_parameters():
        (rate,) = (rate for part, rate in expected.items() if name.startswith(part))
        assert rates.pop(weight) == rate, name
    assert not rates


def test_the_encoder_is_taught_as_soon_as_its_gradient_is_there():
    handed, taught_with = [], []
    embedding = torch.ones(3, requires_grad=True)

    def beside(work):
        handed.append(work)
        return work

    with network_updates.encoder_backward_beside(lambda: taught_with.append(embedding.grad.clone()), embedding, beside):
        backward((2 * embedding.sum(), None))
        assert len(handed) == 1 and not taught_with
    assert [gradient.tolist() for gradient in taught_with] == [[2.0] * 3]
    embedding.sum().backward()
    assert len(handed) == 1  # that hook is gone


def test_without_a_gradient_the_encoder_is_taught_at_the_end():
    embedding, taught_with = torch.ones(3, requires_grad=True), []
    with network_updates.encoder_backward_beside(lambda: taught_with.append(embedding.grad), embedding, beside):
        assert not taught_with
    assert taught_with == [None]
