"""What holds residuals small and passers-by transparent: its gradient, and whom it reaches."""

import torch

from core.rasterizer.view import view_of
from core.training.losses import regularisers
from tests.small import ring_camera


def test_the_residuals_norm_passes_gradcheck():
    residual = torch.randn(5, 4, 3, generator=torch.Generator().manual_seed(0)).double()
    assert torch.autograd.gradcheck(regularisers.residual_norm, residual.requires_grad_())


def test_transient_rows_are_those_in_front_inside_the_mask():
    camera = ring_camera(0.0)
    view = view_of(camera)
    # The fourth is behind it.
    means = torch.tensor([[-0.8, 0.0, 0.0], [0.8, 0.0, 0.0], [-0.8, 0.0, 0.0], [0.8, 0.0, -9.0], [50.0, 0.0, 0.0]])
    mask = torch.full((1, 9, 12), 0.51)
    mask[:, :, :6] = 0.49  # the left half of the picture is hidden
    rows = regularisers.transient_rows(means, torch.tensor([0.11, 0.9, 0.09, 0.9, 0.9]), mask, view)
    assert rows.tolist() == [True, False, False, False, False]
    lower = torch.full((1, 9, 12), 0.49)
    lower[:, 4:] = 0.51  # in the picture's lower half nothing is hidden
    heights = torch.tensor([[0.0, -0.2, 0.0], [0.0, 0.1, 0.0]])
    assert regularisers.transient_rows(heights, torch.ones(2), lower, view).tolist() == [True, False]
    beside = torch.zeros(200, 3)
    beside[:, 0] = torch.linspace(-4.0, 0.0, 200)
    shown = torch.from_numpy(camera.project(beside.double().numpy())[0][:, 0] >= 0)
    assert 0 < int(shown.sum()) < 200 - 10  # some lie less than a cell of the mask beyond the edge
    assert torch.equal(regularisers.transient_rows(beside, torch.ones(200), torch.zeros(1, 9, 12), view), shown)
