"""Adam for the networks: the steps of torch.optim.Adam, bit for bit, without torch's compiler."""

import pytest
import torch

from core.training.network_adam import NetworkAdam
from tests.programs import run_python

SHAPES, RATES = [(3, 4), (5,), (2, 2, 2)], [0.01, 0.02, 0.01]


def weights_of(seed: int) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return [torch.randn(shape, generator=generator).requires_grad_() for shape in SHAPES]


def grouped(weights: list[torch.Tensor]) -> NetworkAdam:
    return NetworkAdam({0.01: [weights[0], weights[2]], 0.02: [weights[1]]})


def give_gradients(weights: list[torch.Tensor], step: int) -> None:
    """The second weight has none in every other step."""
    generator = torch.Generator().manual_seed(step)
    for number, weight in enumerate(weights):
        gradient = torch.randn(weight.shape, generator=generator)
        weight.grad = None if number == 1 and step % 2 else gradient


def test_a_step_is_that_of_torch():
    ours, theirs = weights_of(0), weights_of(0)
    optimizer = grouped(ours)
    reference = torch.optim.Adam(
        [{"params": [weight], "lr": rate} for weight, rate in zip(theirs, RATES)],
        betas=(0.9, 0.999),
        eps=1e-8,
        fused=True,
    )
    for step in range(7):
        for weights in (ours, theirs):
            give_gradients(weights, step)
        optimizer.step(optimizer.rates)
        reference.step()
        assert all(map(torch.equal, ours, theirs)), step


def test_a_restored_state_goes_on_bit_for_bit():
    weights = weights_of(1)
    optimizer = grouped(weights)
    for step in range(3):
        give_gradients(weights, step)
        optimizer.step(optimizer.rates)
    again = [weight.detach().clone().requires_grad_() for weight in weights]
    restored = grouped(again)
    restored.restore({name: tensor.clone() for name, tensor in optimizer.tensors().items()})
    for each, its_weights in ((optimizer, weights), (restored, again)):
        give_gradients(its_weights, 3)
        each.step([0.001, 0.002])
    assert all(map(torch.equal, weights, again))


def test_a_state_of_other_weights_is_refused():
    optimizer, state = grouped(weights_of(1)), grouped(weights_of(1)).tensors()
    with pytest.raises(ValueError, match="0.exp_avg of"):
        optimizer.restore(state | {"0.exp_avg": torch.zeros(1, 4)})
    del state["2.step"]
    with pytest.raises(KeyError, match="2.step"):
        optimizer.restore(state)


def test_a_step_with_found_inf_leaves_no_trace():
    weights = weights_of(2)
    optimizer = grouped(weights)
    give_gradients(weights, 0)
    optimizer.step(optimizer.rates, torch.tensor(0.0))
    before = [tensor.clone() for tensor in (*weights, *optimizer.tensors().values())]
    give_gradients(weights, 1)
    optimizer.step(optimizer.rates, torch.tensor(1.0))
    assert all(map(torch.equal, before, (*weights, *optimizer.tensors().values())))
    optimizer.zero_grad()
    assert all(weight.grad is None for weight in weights)


def test_training_does_not_load_torchs_compiler(tmp_path):
    script = """
import sys
from pathlib import Path
from core.data.prepare import prepared
from core.report import QUIET
from core.training.trainer import Trainer
from tests.data.room_corner import write_corner
from tests.small import small_settings

folder = Path(sys.argv[1])
collection = prepared(write_corner(folder, count=9), folder / "points", QUIET)
trainer = Trainer(collection, small_settings(steps=3), folder / "run")
for _ in range(3):
    trainer.step()
assert not {"torch._dynamo", "sympy"} & sys.modules.keys()
"""
    run_python(script, tmp_path)
