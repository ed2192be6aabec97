"""Adam for the networks: torch's own step, without torch.optim.Adam around it.

To make one of those loads torch's compiler, which takes a second or two before the first step of a run, and 140 MB
until its last.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor
from torch.optim.adam import adam

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8  # the defaults of Adam's authors


@dataclass
class Learner:
    """A weight that learns. steps: (), float32, how many it has taken. first, second: its moments."""

    weight: Tensor
    steps: Float[Tensor, ""] = field(init=False)
    first: Tensor = field(init=False)
    second: Tensor = field(init=False)

    def __post_init__(self):
        self.steps = torch.zeros((), device=self.weight.device)
        self.first, self.second = torch.zeros_like(self.weight), torch.zeros_like(self.weight)


class NetworkAdam:
    """Adam (Kingma & Ba 2015) for weights in groups, each with a learning rate. On a GPU, a step can be recorded as a
    CUDA graph.

    rates: of each group, at the start of a run. groups: the Learners of each.
    """

    def __init__(self, weights: dict[float, list[Tensor]]):
        """weights: those that learn at each rate."""
        self.rates = list(weights)
        self.groups = [[Learner(weight) for weight in group] for group in weights.values()]

    @property
    def learners(self) -> list[Learner]:
        """All of them, group by group."""
        return [learner for group in self.groups for learner in group]

    def zero_grad(self) -> None:
        """Drop all gradients."""
        for learner in self.learners:
            learner.weight.grad = None

    @torch.no_grad()
    def step(self, rates: Iterable[float | Tensor], found_inf: Float[Tensor, ""] | None = None) -> None:
        """Move all weights that have a gradient.

        rates: of each group; on a GPU tensors () there. found_inf: on a GPU, nothing is moved if it is 1.
        """
        for group, rate in zip(self.groups, rates, strict=True):
            moved = [learner for learner in group if learner.weight.grad is not None]
            adam(
                [learner.weight for learner in moved],
                [learner.weight.grad for learner in moved],  # type: ignore[misc]
                [learner.first for learner in moved],
                [learner.second for learner in moved],
                [],
                [learner.steps for learner in moved],
                fused=True,
                capturable=found_inf is not None,
                found_inf=found_inf,
                amsgrad=False,
                beta1=BETA_1,
                beta2=BETA_2,
                lr=rate,
                weight_decay=0.0,
                eps=EPSILON,
                maximize=False,
            )

    def tensors(self) -> dict[str, Tensor]:
        """Its state, by the number of the weight and what it is."""
        return {
            f"{number}.{name}": tensor
            for number, learner in enumerate(self.learners)
            for name, tensor in (("step", learner.steps), ("exp_avg", learner.first), ("exp_avg_sq", learner.second))
        }

    def restore(self, saved: dict[str, Tensor]) -> None:
        """Take over a state of the same weights; KeyError or ValueError if it is not."""
        for name, tensor in self.tensors().items():
            if saved[name].shape != tensor.shape:
                raise ValueError(f"{name} of {tuple(saved[name].shape)} instead of {tuple(tensor.shape)}")
            tensor.copy_(saved[name])
