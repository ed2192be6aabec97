"""Refinement: an embedding follows the photo that it was read from, seen by that photo's own camera."""

from collections.abc import Callable, Iterator

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from core.threads import threads_for_blocks

# Those of WildGaussians and nerfbaselines.
STEPS = 128
RATE = 0.1

Render = Callable[[Float[Tensor, " e"]], Float[Tensor, "h w 3"]]


def refinement(
    render: Render, embedding: Float[Tensor, " e"], picture: Float[Tensor, "h w 3"], valid: Bool[Tensor, "h w"] | None = None
) -> Iterator[Float[Tensor, " e"]]:
    """The best embedding after 0, 1, ... STEPS of Adam on the mean |render - picture|; none if the look does not follow it.

    L1, because passers-by in the picture would pull harder on a squared error. Of all steps, the start among them, the
    one that fits `picture` best is kept, so that the refinement never makes what it sees worse. The same for any number of
    threads, which torch's own products are not on every processor.
    """
    embedding = embedding.detach().clone().requires_grad_()
    optimizer = torch.optim.Adam([embedding], lr=RATE)
    best, least = embedding.detach().clone(), float("inf")
    for _ in range(STEPS + 1):
        optimizer.zero_grad()
        with torch.enable_grad(), threads_for_blocks():
            difference = (render(embedding) - picture).abs()
            loss = difference.mean() if valid is None else difference[valid].mean()
            if not loss.requires_grad:
                return
            loss.backward()
        if float(loss.detach()) < least:
            best, least = embedding.detach().clone(), float(loss.detach())
        yield best
        optimizer.step()


def refined(
    render: Render, embedding: Float[Tensor, " e"], picture: Float[Tensor, "h w 3"], valid: Bool[Tensor, "h w"] | None = None
) -> Float[Tensor, " e"] | None:
    """The embedding after all steps of `refinement`; None if the look does not follow it."""
    best = None
    for best in refinement(render, embedding, picture, valid):
        pass
    return best
