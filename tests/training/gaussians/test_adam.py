"""Adam of the rows that are seen: what torch computes, what its definition says, and nothing for the other rows."""

import torch

from core.training.gaussians.adam import Moved, adam_rows, plain_adam_rows


def test_adam_equals_torch_where_every_row_is_seen():
    ours = torch.randn(50, 3)
    theirs = ours.clone().requires_grad_()
    optimizer = torch.optim.Adam([theirs], lr=0.01, eps=1e-15)
    first, second, counts = torch.zeros(50, 3), torch.zeros(50, 3), torch.zeros(50, dtype=torch.int32)
    for _ in range(20):
        gradient = torch.randn(50, 3)
        theirs.grad = gradient.clone()
        optimizer.step()
        adam_rows([Moved(ours, first, second, gradient, torch.full((3,), 0.01))], counts, torch.arange(50))
    torch.testing.assert_close(ours, theirs.detach(), rtol=1e-5, atol=1e-6)  # float32, 20 steps


def test_adam_leaves_unseen_rows_alone_and_both_paths_agree():
    rows = torch.arange(0, 9000, 2)
    before = [torch.randn(9000, *shape) for shape in ((4, 3), (3,), ())]
    gradients = [torch.randn(len(rows), *values.shape[1:]) for values in before]
    rates = [torch.rand(values[0].numel()) for values in before]
    results = []
    for update in (adam_rows, plain_adam_rows):
        after = [values.clone() for values in before]
        moments = [(torch.zeros_like(values), torch.zeros_like(values)) for values in before]
        counts = torch.zeros(9000, dtype=torch.int32)
        update([Moved(a, *m, g, r) for a, m, g, r in zip(after, moments, gradients, rates)], counts, rows)
        assert all(torch.equal(a[1::2], b[1::2]) for a, b in zip(after, before))
        assert counts.tolist() == [1, 0] * 4500
        results.append(after)
    torch.testing.assert_close(*results, rtol=1e-5, atol=1e-6)
