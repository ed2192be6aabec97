"""What is started from a graph is what was recorded, with the weights and inputs of the moment. On a GPU, or by graphs that this file plays itself."""

from contextlib import contextmanager, nullcontext
from types import SimpleNamespace

import pytest
import torch
from torch import nn
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from core.appearance import sh_transfer
from core.system import cuda_graph
from core.system.cuda_graph import Replayed
from core.training.trainer import Trainer
from tests.small import small_collection, small_settings

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


class Played(TorchDispatchMode):
    """Operations on a CPU as a CUDA graph keeps them: done again on the same memory, whatever it holds by then."""

    def __init__(self):
        super().__init__()
        self.done = []

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        result = function(*args, **(kwargs or {}))
        self.done.append((function, args, kwargs or {}, result))
        return result

    def pool(self):
        return None

    def replay(self) -> None:
        with torch.no_grad():
            for function, args, kwargs, kept in self.done:
                again = function(*args, **kwargs)
                for place, number in zip(tree_leaves(kept), tree_leaves(again)):
                    if isinstance(place, torch.Tensor) and place.data_ptr() != number.data_ptr():
                        place.copy_(number)


@pytest.fixture(autouse=True)
def graphs(monkeypatch):
    """Graphs of torch where there is a GPU, else those that are Played."""
    if DEVICE == "cuda":
        return

    @contextmanager
    def recorded(graph: Played, pool=None):
        with graph:
            yield

    stream = SimpleNamespace(wait_stream=lambda other: None)
    replaced = {"current_stream": lambda: stream, "Stream": lambda: stream, "stream": lambda _: nullcontext(), "CUDAGraph": Played, "graph": recorded}
    for name, other in replaced.items():
        monkeypatch.setattr(torch.cuda, name, other)
    monkeypatch.setattr(cuda_graph, "can_record", lambda device: True)


class Network(nn.Module):
    """Two results and one that is None; the second depends on nothing that learns, and neither does anything on one weight."""

    def __init__(self):
        super().__init__()
        self.layer, self.unused = nn.Linear(3, 2), nn.Parameter(torch.ones(1))

    def forward(self, learned, given):
        return torch.tanh(self.layer(learned)) * given, None, given * 2


def inputs(rows: int) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.randn(rows, 3, device=DEVICE, requires_grad=True), torch.randn(rows, 2, device=DEVICE)


def outcome(function, network: Network, given) -> list[torch.Tensor | None]:
    """The results, and the gradients of what learns."""
    learned = given[0].detach().requires_grad_()
    first, nothing, second = function(learned, given[1])
    assert nothing is None and not second.requires_grad
    first.square().sum().backward()
    found = [first.detach().clone(), second.clone(), learned.grad.clone(), network.layer.weight.grad.clone(), network.layer.bias.grad.clone()]
    assert network.unused.grad is None
    network.zero_grad()
    return found


def test_results_and_gradients_are_those_of_the_network():
    """Inputs are others each time, and weights are changed in their place."""
    network = Network().to(DEVICE)
    replayed = Replayed(network)
    for rows in (5, 5, 1, 5, 1):
        given = inputs(rows)
        for ours, expected in zip(outcome(replayed, network, given), outcome(network, network, given), strict=True):
            torch.testing.assert_close(ours, expected, rtol=1e-6, atol=1e-6)  # a GPU's library may choose another product
        with torch.no_grad():
            for weight in network.parameters():
                weight += 0.1


def test_every_set_of_shapes_is_recorded_once_and_none_without_gradients():
    replayed = Replayed(Network().to(DEVICE))
    with torch.no_grad():
        replayed(*inputs(4))
    assert not replayed.recordings
    for rows in (4, 7, 4):
        replayed(*inputs(rows))
    assert len(replayed.recordings) == 2


def test_gradients_of_another_use_of_the_weights_add_up():
    network = Network().to(DEVICE)
    replayed, given = Replayed(network), inputs(5)
    for _ in range(3):
        other = network(*given)[0].sum()
        replayed(*given)[0].sum().backward()
        other.backward()
        both = network.layer.weight.grad.clone()
        network.zero_grad()
        (2 * network(*given)[0].sum()).backward()
        torch.testing.assert_close(both, network.layer.weight.grad)
        network.zero_grad()


def test_steps_are_the_same_whether_or_not_their_networks_are_started_from_graphs(tmp_path, monkeypatch):
    """Encoder, mask and gauge, in the losses of steps that depend on what the steps before taught them."""
    monkeypatch.setattr(sh_transfer, "is_fast", lambda sh: False)  # what a CPU does in NumPy, no graph of torch's operations sees
    torch.set_num_threads(1)
    settings = small_settings(device=DEVICE, mask_start=0.0, mask_apply=0.0, gauge=1.0, held_out_checks=0, densify_rounds=0)
    collection = small_collection(tmp_path)

    def losses() -> tuple[list[float], int]:
        trainer = Trainer(collection, settings, tmp_path)
        found = [trainer.step().loss for _ in range(6)]
        parts = trainer.model.encode, trainer.objective.cell_loss, trainer.objective.gauge_loss.size
        return found, sum(len(part.recordings) for part in parts)

    ours, recordings = losses()
    assert recordings == 3
    monkeypatch.setattr(cuda_graph, "can_record", lambda device: False)
    expected, recordings = losses()
    assert recordings == 0
    assert ours == pytest.approx(expected, abs=1e-6 if DEVICE == "cpu" else 1e-5)
