"""What is started from a graph is what was recorded, with the weights and inputs of the moment."""

import pytest
import torch
from torch import nn

from core.system.cuda_graph import Replayed

ON_GPU = torch.cuda.is_available()
on_gpu = pytest.mark.skipif(not ON_GPU, reason="there is no GPU to record on")


class Network(nn.Module):
    """Two results and one that is None; the second depends on no input that learns."""

    def __init__(self):
        super().__init__()
        self.layer, self.unused = nn.Linear(3, 2), nn.Parameter(torch.ones(1))

    def forward(self, learned, given):
        return torch.tanh(self.layer(learned)) * given, None, given * 2


def outcome(network, learned, given, plain):
    """Results and gradients after two backward passes of different shapes of loss, as a step makes them."""
    learned = learned.clone().requires_grad_()
    first, nothing, second = plain(learned, given)
    assert nothing is None and not second.requires_grad
    first.square().sum().backward()
    found = [first.detach().clone(), second.clone(), learned.grad, *(weight.grad for weight in network.parameters())]
    network.zero_grad()
    return found


@pytest.mark.parametrize("rows", [5, 1])
def test_results_and_gradients_are_those_of_the_network(rows):
    """On a CPU it is the network itself. Weights are changed in their place and inputs are others each time."""
    device = "cuda" if ON_GPU else "cpu"
    network = Network().to(device)
    replayed = Replayed(network)
    for _ in range(3):
        inputs = torch.randn(rows, 3, device=device), torch.randn(rows, 2, device=device)
        for ours, expected in zip(outcome(network, *inputs, replayed), outcome(network, *inputs, network), strict=True):
            assert (ours is None) == (expected is None)
            if ours is not None:
                torch.testing.assert_close(ours, expected, rtol=1e-6, atol=1e-6)
        with torch.no_grad():
            for weight in network.parameters():
                weight += 0.1


@on_gpu
def test_every_set_of_shapes_is_recorded_once_and_none_without_gradients():
    replayed = Replayed(Network().cuda())
    with torch.no_grad():
        replayed(torch.zeros(4, 3, device="cuda"), torch.zeros(4, 2, device="cuda"))
    assert not replayed.recordings
    for rows in (4, 7, 4):
        replayed(torch.zeros(rows, 3, device="cuda"), torch.zeros(rows, 2, device="cuda"))
    assert len(replayed.recordings) == 2


@on_gpu
def test_gradients_of_another_use_of_the_weights_add_up():
    network = Network().cuda()
    replayed = Replayed(network)
    inputs = torch.randn(5, 3, device="cuda"), torch.randn(5, 2, device="cuda")
    for _ in range(2):
        network.zero_grad()
        plain = network(*inputs)[0].sum()
        (replayed(*inputs)[0].sum()).backward()
        plain.backward()
        both = network.layer.weight.grad.clone()
        network.zero_grad()
        (2 * network(*inputs)[0].sum()).backward()
        torch.testing.assert_close(both, network.layer.weight.grad)
