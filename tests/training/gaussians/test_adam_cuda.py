"""The GPU's Adam against the CPU's; by Triton's interpreter where there is no GPU."""

import pytest
import torch

from core.training.gaussians.adam import LARGEST_GRADIENT
from core.training.gaussians.gaussians import Gaussians
from tests.training.learned import assert_same

pytest.importorskip("triton", reason="Triton is not installed")

from core.training.gaussians import adam_cuda

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


ROWS = torch.arange(0, 300, 2)
RATES = {"means": torch.rand(3), "logit_opacities": torch.rand(1), "sh": torch.rand(12), "latents": torch.rand(2)}


def aged_gaussians(oldest: int) -> Gaussians:
    """300, of which the last 50 are sky, of any age up to those whose corrections are 1;
    the sky's geometry has never moved."""
    torch.manual_seed(0)
    shapes = {"means": (3,), "logit_opacities": (), "sh": (4, 3), "latents": (2,)}
    gaussians = Gaussians.of({name: torch.randn(300, *shape) for name, shape in shapes.items()}, sky_count=50)
    for name, columns in ((name, adam_cuda.free_columns(name, len(RATES[name]))) for name in shapes):
        for moments, scale in ((gaussians.first, 0.1 * torch.randn(300)), (gaussians.second, 0.1 * torch.rand(300))):
            flat = moments[name].view(300, -1)
            flat[:] = scale[:, None]
            flat[250:, columns:] = 0
    gaussians.counts = torch.tensor([0, 1, 99, 32_000, 2**31 - 2], dtype=torch.int32).repeat(60).clamp(max=oldest)
    return gaussians


def stepped(
    gaussians: Gaussians, step, taken: bool = True, rates: dict = RATES, rows: torch.Tensor = ROWS
) -> dict[str, torch.Tensor]:
    """All tensors after a step with the same gradients each time, of which some are beyond all bounds."""
    torch.manual_seed(1)
    rows = rows.to(gaussians.counts.device)
    leaves = gaussians.leaves(rows)
    for leaf in leaves.values():
        leaf.grad = torch.randn(leaf.shape).to(leaf.device)
        leaf.grad[:1], leaf.grad[1:2] = 3e38, -2 * LARGEST_GRADIENT
    rates = {name: rate.to(rows.device) for name, rate in rates.items()}
    step(gaussians, rows, leaves, rates, torch.tensor(taken, device=rows.device))
    return {name: tensor.cpu() for name, tensor in gaussians.tensors().items()}


def test_both_agree_and_leave_unseen_rows_and_the_domes_shape_alone():
    # The CPU's table of corrections ends with the oldest row; from 32,767 updates on they are 1.
    expected = stepped(aged_gaussians(oldest=100_000), Gaussians.step)
    before = aged_gaussians(oldest=2**31 - 2)
    found = stepped(aged_gaussians(oldest=2**31 - 2).to(torch.device(DEVICE)), adam_cuda.step)
    for name, tensor in before.tensors().items():
        assert torch.equal(found[name][1::2], tensor[1::2]), name
        if name != "counts":
            torch.testing.assert_close(found[name], expected[name], rtol=1e-6, atol=5e-7)  # of order 1, rounded
    assert torch.equal(found["counts"][::2], before.counts[::2] + 1)
    assert torch.equal(found["parameters.means"][250:], before.parameters["means"][250:])
    assert not torch.equal(found["parameters.sh"][250:, 0], before.parameters["sh"][250:, 0])


def test_rows_of_minus_one_are_skipped():
    expected = stepped(aged_gaussians(oldest=100_000).to(torch.device(DEVICE)), adam_cuda.step)
    rows = torch.cat([ROWS, torch.full((70,), -1)])
    found = aged_gaussians(oldest=100_000).to(torch.device(DEVICE))
    torch.manual_seed(1)
    leaves = {name: leaf.detach() for name, leaf in found.leaves(ROWS.to(DEVICE)).items()}
    leaves = {
        name: torch.cat([leaf, leaf.new_zeros(70, *leaf.shape[1:])]).requires_grad_() for name, leaf in leaves.items()
    }
    for leaf in leaves.values():
        leaf.grad = torch.cat([torch.randn(len(ROWS), *leaf.shape[1:]), torch.ones(70, *leaf.shape[1:])]).to(
            leaf.device
        )
        leaf.grad[:1], leaf.grad[1:2] = 3e38, -2 * LARGEST_GRADIENT
    adam_cuda.step(
        found,
        rows.to(DEVICE),
        leaves,
        {name: rate.to(DEVICE) for name, rate in RATES.items()},
        torch.tensor(True, device=DEVICE),
    )
    assert_same({name: tensor.cpu() for name, tensor in found.tensors().items()}, expected)


def test_a_step_that_is_not_taken_changes_nothing():
    found = stepped(aged_gaussians(oldest=5).to(torch.device(DEVICE)), adam_cuda.step, taken=False)
    assert_same(found, aged_gaussians(oldest=5).tensors())


def test_what_does_not_learn_yet_stays_as_it_is():
    rates = {name: RATES[name] for name in ("sh", "latents")}
    expected = stepped(aged_gaussians(oldest=99), Gaussians.step, rates=rates)
    found = stepped(aged_gaussians(oldest=99).to(torch.device(DEVICE)), adam_cuda.step, rates=rates)
    for name, tensor in aged_gaussians(oldest=99).tensors().items():
        torch.testing.assert_close(found[name], expected[name], rtol=1e-6, atol=5e-7)
        assert torch.equal(found[name], tensor) == name.endswith(
            ("means", "logit_opacities", "gradient_sum", "seen")
        ), name


def test_a_view_of_nothing_changes_nothing():
    found = stepped(aged_gaussians(oldest=5).to(torch.device(DEVICE)), adam_cuda.step, rows=ROWS[:0])
    assert_same(found, aged_gaussians(oldest=5).tensors())


@pytest.mark.parametrize("count", [1, adam_cuda.ROWS, adam_cuda.ROWS + 1])
def test_programs_that_are_not_full_keep_to_their_rows(count):
    expected = stepped(aged_gaussians(oldest=99), Gaussians.step, rows=ROWS[:count])
    found = stepped(aged_gaussians(oldest=99).to(torch.device(DEVICE)), adam_cuda.step, rows=ROWS[:count])
    torch.testing.assert_close(found, expected, rtol=1e-6, atol=5e-7)
