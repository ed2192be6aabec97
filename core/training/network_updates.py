"""How the networks learn: encoder, mask, SH transfer and tables, each by Adam at its own rate."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from core.config import Settings
from core.training import guards, schedule


def optimizer_of(model: nn.Module, settings: Settings) -> torch.optim.Adam | None:
    """The optimizer of all weights of the model; None for a model without weights."""
    rates = {
        "encoder.unet": settings.network_rate,
        "encoder": settings.encoder_rate,
        "embedding_table": settings.embedding_rate,
    }
    groups: dict[float, list[Tensor]] = {}
    for name, weight in model.named_parameters():
        rate = next((rate for part, rate in rates.items() if name.startswith(part)), settings.network_rate)
        groups.setdefault(rate, []).append(weight)
    if not groups:
        return None
    on_cpu = next(model.parameters()).device.type == "cpu"
    return torch.optim.Adam(
        [{"params": g, "lr": rate, "rate": rate} for rate, g in groups.items()], fused=True, capturable=not on_cpu
    )


def rates_at(optimizer: torch.optim.Adam | None, progress: float) -> list[float]:
    """The learning rate of each parameter group at this progress of the run."""
    groups = [] if optimizer is None else optimizer.param_groups
    return [schedule.decayed(group["rate"], progress, schedule.NETWORK_RATE_DECAY) for group in groups]


@contextmanager
def encoder_backward_beside(
    work: Callable[[], None], embedding: Float[Tensor, " e"], beside: Callable[[Callable[[], None]], Callable[[], Any]]
) -> Iterator[None]:
    """Run `work`, the encoder's backward pass, in parallel with the rest of the SH transfer's backward pass,
    which runs inside the block.

    embedding: the leaf from whose gradient `work` starts. beside: see `threads.beside`; it gets `work` as soon as that
    gradient is complete, when the SH transfer's hidden layers are still to come. The end of the block waits for `work`,
    and does it there if the embedding got no gradient.
    """
    started: list[Callable[[], None]] = []

    def start(_: Tensor) -> None:
        started.append(beside(work))

    # Taken off at the end: `work` holds the embedding, which holds the hook, and Python's collector does not see
    # through torch.
    with embedding.register_post_accumulate_grad_hook(start):
        yield
    (started[0] if started else work)()


def update(
    optimizer: torch.optim.Adam | None, rates: Iterable[float | Tensor], taken: Bool[Tensor, ""]
) -> Bool[Tensor, ""]:
    """One step of the optimizer if the training step is `taken` and all gradients are finite; returns whether.

    rates: of each group; on a GPU tensors () there, like everything that a recorded step reads.
    """
    if optimizer is None:
        return taken
    learned = taken & guards.finite(
        (weight.grad for group in optimizer.param_groups for weight in group["params"]), taken.device
    )
    if guards.known_invalid(learned):
        return learned
    for group, rate in zip(optimizer.param_groups, rates, strict=True):
        group["lr"] = rate
    if learned.device.type != "cpu":
        # As torch's GradScaler leaves the choice to the GPU.
        optimizer.found_inf = (~learned).float()  # type: ignore[attr-defined]
    optimizer.step()
    return learned
