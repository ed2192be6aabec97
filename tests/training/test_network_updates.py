"""When the encoder is taught: as soon as the embedding has its gradient, or at the end."""

import torch

from core.training import network_updates
from core.training.losses.backward import backward


def test_the_encoder_is_taught_once_its_gradient_is_there_while_others_are_on_their_way(monkeypatch):
    handed, taught_with = [], []
    monkeypatch.setattr(network_updates, "beside", lambda work: handed.append(work) or work)
    embedding = torch.ones(3, requires_grad=True)
    with network_updates.encoder_backward_beside(lambda: taught_with.append(embedding.grad.clone()), embedding):
        backward((2 * embedding.sum(), None))
        assert len(handed) == 1 and not taught_with
    assert [gradient.tolist() for gradient in taught_with] == [[2.0] * 3]
    embedding.sum().backward()
    assert len(handed) == 1  # that hook is gone


def test_without_a_gradient_it_is_taught_at_the_end():
    embedding, taught_with = torch.ones(3, requires_grad=True), []
    with network_updates.encoder_backward_beside(lambda: taught_with.append(embedding.grad), embedding):
        assert not taught_with
    assert taught_with == [None]
