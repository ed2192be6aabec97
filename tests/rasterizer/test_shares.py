"""A picture's cells as a linear map of colours:
every backend against the reference, and the reference against its own picture."""

import pytest
import torch

from core.rasterizer import create
from core.rasterizer.importance import shares_of_picture
from core.rasterizer.reference import project
from core.rasterizer.shares import Shares
from core.scene.cells import CELL_PX, cell_of_pixels, cell_sums
from core.scene.harmonics import colour
from tests.rasterizer.backends import FAST_BACKENDS, backend_or_skip
from tests.rasterizer.scenes import SCENES
from tests.rasterizer.tolerances import PICTURE, verdict

NAMES = (
    "random_degree_3",
    "opaque_stack",
    "huge_splat",
    "picture_1x40",
    "picture_40x1",
    "picture_33x17",
    "poisoned",
    "nothing_visible",
    "empty",
)


def weight_of(judge) -> torch.Tensor:
    """What no rounding flips, each pixel weighing something else."""
    return judge.cotangent[..., 0].abs()


def dense(shares: Shares) -> torch.Tensor:
    return torch.zeros(shares.shape, dtype=shares.values.dtype).index_put(
        (shares.cells, shares.gaussians), shares.values
    )


@pytest.mark.parametrize("name", NAMES)
def test_cells_show_what_the_picture_shows_in_them(name):
    judge = verdict(SCENES[name])
    splats, camera, weight = judge.scene.splats.map(torch.Tensor.double), judge.scene.camera, weight_of(judge).double()
    shares = create("reference").shares(splats, camera, weight)
    rows = create("reference").visible(splats, camera).rows
    colours = torch.zeros(len(splats), 3, dtype=torch.float64)
    colours[rows] = colour(splats.sh[rows], project(splats[rows], camera).directions)
    expected = cell_sums(create("reference").render(splats, camera).detach() * weight[..., None])
    torch.testing.assert_close(shares.mixed(colours), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("backend", FAST_BACKENDS)
def test_every_backend_finds_the_shares_of_the_reference(backend, name):
    judge = verdict(SCENES[name])
    weight = weight_of(judge)
    expected = create("reference").shares(
        judge.scene.splats.map(torch.Tensor.double), judge.scene.camera, weight.double()
    )
    shares = backend_or_skip(backend, name).shares(judge.scene.splats, judge.scene.camera, weight)
    error = (dense(shares).double() - dense(expected)).abs()
    assert shares.shape == expected.shape and (error <= PICTURE * cell_sums(weight[..., None])).all()


def test_cells_are_numbered_row_by_row_and_cut_off_at_the_edge():
    camera = SCENES["picture_33x17"]().camera
    cells = cell_of_pixels(torch.ones(camera.height, camera.width))
    across = -(-camera.width // CELL_PX)
    assert (
        cells[0, 0] == 0
        and cells[0, CELL_PX] == 1
        and cells[CELL_PX, 0] == across
        and cells.shape == (camera.height, camera.width)
    )
    counts = cell_sums(torch.ones(camera.height, camera.width, 1))[:, 0]
    assert torch.equal(counts, torch.bincount(cells.flatten()).float()) and counts[0] == CELL_PX**2 > counts[-1] > 0


def test_the_product_has_the_gradient_of_a_matrix_product():
    cells, gaussians = (torch.rand(6, 5) < 0.5).nonzero(as_tuple=True)
    shares = Shares(cells, gaussians, torch.rand(len(cells), dtype=torch.float64), (6, 5))
    colours = torch.rand(5, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(shares.mixed, colours)
    torch.testing.assert_close(shares.mixed(colours), dense(shares) @ colours)
    torch.testing.assert_close(shares.of_gaussians(), dense(shares).sum(dim=0))
    torch.testing.assert_close(shares.of_cells(), dense(shares).sum(dim=1))


@pytest.mark.parametrize("backend", ["reference", *FAST_BACKENDS])
def test_the_shares_of_a_picture_are_those_of_its_cells_together(backend):
    judge = verdict(SCENES["random_degree_3"])
    splats, camera, rasterizer = judge.scene.splats, judge.scene.camera, backend_or_skip(backend, "random_degree_3")
    part = weight_of(judge) > weight_of(judge).median()
    found = shares_of_picture(splats, camera, rasterizer, part, ~part)
    for shares, counted in zip(found, (torch.ones_like(part), part, ~part), strict=True):
        expected = create("reference").shares(splats, camera, counted.float()).of_gaussians() / part.numel()
        torch.testing.assert_close(shares, expected, rtol=0, atol=2e-7)
