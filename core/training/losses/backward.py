"""The backward pass of a step, whose gradients begin at several tensors."""

import torch
from torch import Tensor


def backward(*roots: tuple[Tensor | None, Tensor | None]) -> None:
    """torch's backward pass from several roots at once: tensors, each paired with its gradient;
    a loss, which is a scalar, with None.

    Left out are roots that are None, that require no gradient, and that are not scalars but come without a gradient.
    """
    tensors, gradients = [], []
    for root, gradient in roots:
        if root is not None and root.requires_grad and (gradient is not None or not root.dim()):
            tensors.append(root)
            gradients.append(gradient)
    if tensors:
        torch.autograd.backward(tensors, gradients)
