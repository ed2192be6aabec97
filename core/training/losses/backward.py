"""The backward pass of a step, whose gradients begin at several tensors."""

import torch
from torch import Tensor


def backward(*roots: tuple[Tensor | None, Tensor | None]) -> None:
    """torch's backward pass from several roots at once: tensors, each paired with its gradient; a loss, which is a scalar, with None.

    Left out are roots that are None, that require no gradient, and that are not scalars but come without a gradient.
    """
    found = [root for root in roots if root[0] is not None and root[0].requires_grad]
    found = [root for root in found if root[1] is not None or not root[0].dim()]
    if found:
        torch.autograd.backward(*zip(*found))
