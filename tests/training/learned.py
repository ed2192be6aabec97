"""What a training has learned, and whether another one has learned the same."""

import torch

from core.training.trainer import Trainer


def learned(trainer: Trainer) -> dict[str, torch.Tensor]:
    """All that a step may change of Gaussians, networks and their optimizer; on a CPU it shares their memory."""
    tensors = {**trainer.gaussians.tensors(), **trainer.model.state_dict(), **trainer.optimizer.tensors()}
    return {name: tensor.cpu() for name, tensor in tensors.items()}


def copied(tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The tensors as they are now."""
    return {name: tensor.clone() for name, tensor in tensors.items()}


def assert_same(found: dict[str, torch.Tensor], expected: dict[str, torch.Tensor]) -> None:
    """The same names and, bit for bit, the same numbers; the first name that differs is told."""
    assert found.keys() == expected.keys()
    for name, tensor in expected.items():
        assert torch.equal(found[name], tensor), name
