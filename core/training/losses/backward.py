"""The backward pass of a step, whose gradients begin at several tensors."""

import torch
from torch import Tensor


@torch.enable_grad()  # also within a backward pass, which turns it off
def backward(*roots: tuple[Tensor | None, Tensor | None]) -> None:
    """torch's backward pass from several roots at once: tensors, each paired with its gradient;
    a loss, which is a scalar, with None.

    Left out are roots that are None, that require no gradient, and that are not scalars but come without a gradient.
    """
    losses = [
        root if gradient is None else _Start.apply(root, gradient)
        for root, gradient in roots
        if root is not None and root.requires_grad and (gradient is not None or not root.dim())
    ]
    if losses:
        torch.autograd.backward(losses)


class _Start(torch.autograd.Function):
    """A stand-in whose gradient by a tensor is the given one; its value is never read.
    For gradients that are given otherwise, torch loads sympy, which takes half a second before the first step."""

    @staticmethod
    def forward(ctx, tensor: Tensor, gradient: Tensor) -> Tensor:
        ctx.save_for_backward(gradient)
        return tensor.new_empty(())

    @staticmethod
    def backward(ctx, _):
        return *ctx.saved_tensors, None
