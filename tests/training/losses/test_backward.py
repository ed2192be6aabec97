"""The backward pass of a step: from several tensors at once, of which some may have no gradient."""

import torch

from core.training.losses.backward import backward


def test_backward_from_several_roots_leaves_out_what_has_no_gradient():
    x = torch.tensor([1.0, 2.0], requires_grad=True)
    y = x * 3
    backward((x.sum(), None), (y, torch.tensor([1.0, 10.0])), (None, None), (torch.zeros(()), None), (x * 5, None))
    assert x.grad.tolist() == [4, 31]
    backward((torch.zeros(()), None))  # nothing to do
