"""How the networks learn: encoder, mask, SH transfer and tables, each by Adam at its own rate."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from jaxtyping import Bool, Float
from torch import Tensor, nn

from core.config import Settings
from core.training import guards, schedule
from core.training.network_adam import NetworkAdam


def optimizer_of(model: nn.Module, settings: Settings) -> NetworkAdam:
    """The optimizer of all weights of the model, which has none in a run without looks and masks."""
    rates = {  # by the beginning of a weight's name; the first one that fits counts
        "encoder.unet": settings.network_rate,
        "encoder": settings.encoder_rate,
        "embedding_table": settings.embedding_rate,
    }
    groups: dict[float, list[Tensor]] = {}
    for name, weight in model.named_parameters():
        rate = next((rate for part, rate in rates.items() if name.startswith(part)), settings.network_rate)
        groups.setdefault(rate, []).append(weight)
    return NetworkAdam(groups)


def rates_at(optimizer: NetworkAdam, progress: float) -> list[float]:
    """The learning rate of each group of weights at this progress of the run."""
    return [schedule.decayed(rate, progress, schedule.NETWORK_RATE_DECAY) for rate in optimizer.rates]


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


def update(optimizer: NetworkAdam, rates: Iterable[float | Tensor], taken: Bool[Tensor, ""]) -> Bool[Tensor, ""]:
    """One step of the optimizer if the training step is `taken` and all gradients are finite; returns whether.

    rates: of each group; on a GPU tensors () there, like everything that a recorded step reads.
    """
    if not optimizer.learners:
        return taken
    learned = taken & guards.finite((learner.weight.grad for learner in optimizer.learners), taken.device)
    if not guards.known_invalid(learned):
        # A GPU chooses itself, as with torch's GradScaler.
        optimizer.step(rates, None if learned.device.type == "cpu" else (~learned).float())
    return learned
