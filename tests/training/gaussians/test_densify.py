"""Density control: which Gaussians are removed, which gradients are gathered, and where new Gaussians come from."""

import numpy as np
import pytest
import torch

from core.training.gaussians import densify
from tests.failing import failing
from tests.small import small_settings
from tests.training.learned import assert_same, copied


def test_pruning_removes_the_faint_the_huge_and_the_broken_but_never_the_sky(gaussians):
    solid, sky = gaussians.solid_count, gaussians.sky_count
    opacities, scales, means = (gaussians.parameters[name] for name in ("logit_opacities", "log_scales", "means"))
    opacities[:2] = torch.logit(torch.tensor([0.019, 0.021]))
    scales[2:4, 1] = torch.tensor([0.51, 0.49]).log()
    means[4, 2] = float("nan")
    densify.prune(gaussians, small_settings(prune_opacity=0.02, largest_scale=0.5))
    assert (gaussians.solid_count, gaussians.sky_count) == (solid - 3, sky)
    assert all(len(tensor) == len(gaussians) for tensor in gaussians.tensors().values())


def test_a_gaussian_that_is_not_finite_is_pruned_also_where_distances_to_points_count(gaussians):
    points = gaussians.parameters["means"][: gaussians.solid_count].double().numpy()
    gaussians.parameters["means"][0] = float("nan")
    gaussians.parameters["means"][1] = 50.0
    densify.prune(gaussians, small_settings(), densify.Surroundings(points, reach=4.0))
    assert gaussians.solid_count == len(points) - 2


def test_axes_that_are_too_thin_are_widened_and_nothing_else_changes(gaussians):
    scales = gaussians.parameters["log_scales"]
    scales[0] = torch.tensor([1e-9, 0.3, 0.02]).log()
    scales[1] = torch.tensor([0.15, 0.15 / 250, 1e-7]).log()
    scales[-1] = torch.tensor([1.0, 1.0, 1e-6]).log()  # of the sky
    before = copied(gaussians.tensors())
    densify.thicken(gaussians)
    assert scales[0].exp().tolist() == pytest.approx([0.001, 0.3, 0.02])
    assert scales[1].exp().tolist() == pytest.approx([0.15, 0.15 / 250, 0.0005])
    before["parameters.log_scales"][:2] = scales[:2]
    assert_same(gaussians.tensors(), before)


@pytest.mark.parametrize("reaching", [0.0, 0.1, 0.5, 1.0])
def test_pruning_by_contribution_keeps_the_strong_and_at_least_a_quarter(gaussians, reaching):
    solid, means = gaussians.solid_count, gaussians.parameters["means"].clone()
    largest = torch.zeros(len(gaussians))
    largest[: round(reaching * solid)] = torch.linspace(0.15, 0.05, round(reaching * solid))
    strong = int((largest >= 0.1).sum())
    densify.prune_by_contribution(gaussians, largest, 0.1)
    quarter = solid - int(0.75 * solid)
    assert gaussians.solid_count == max(strong, quarter) and gaussians.sky_count == len(means) - solid
    assert torch.equal(
        gaussians.parameters["means"][: gaussians.solid_count], means[: gaussians.solid_count]
    )  # the strongest
    gaussians.keep(torch.zeros(len(gaussians), dtype=torch.bool))
    densify.prune_by_contribution(gaussians, torch.zeros(len(gaussians)), 0.1)
    assert gaussians.solid_count == 0


@pytest.mark.parametrize("gather", [densify.gather, densify.plain_gather])
def test_screen_gradients_are_gathered_in_half_pictures_unless_the_step_is_dropped(gaussians, gather):
    rows, pulls = torch.tensor([1, 4, 5]), torch.tensor([[3.0, 0.0], [0.0, -2.0], [0.6, 0.4]])
    for taken in (True, True, False):
        gather(
            gaussians, rows, pulls if taken else pulls * float("nan"), torch.tensor([10.0, 15.0]), torch.tensor(taken)
        )
    assert gaussians.seen[:6].tolist() == [0, 2, 0, 0, 2, 2]
    expected = torch.tensor([0, 60, 0, 0, 60, 2 * 72**0.5])  # hypot(0.6 * 10, 0.4 * 15) = sqrt(72)
    torch.testing.assert_close(gaussians.gradient_sum[:6], expected)


def test_growth_clones_the_small_and_splits_the_large(gaussians):
    solid = gaussians.solid_count
    gaussians.seen.fill_(1)
    gaussians.gradient_sum[:2] = 1.0
    gaussians.parameters["log_scales"][0] = np.log(0.011)  # 3DGS: above a hundredth
    gaussians.parameters["log_scales"][1] = np.log(0.009)
    small = gaussians.parameters["means"][1].clone()
    densify.grow(gaussians, 100, torch.Generator().manual_seed(0))
    parameters = gaussians.parameters
    assert gaussians.solid_count == solid + 2
    expected = torch.full((3,), 0.011 / 1.6)
    torch.testing.assert_close(parameters["log_scales"][0].exp(), expected)
    torch.testing.assert_close(parameters["log_scales"][solid].exp(), expected)
    assert torch.equal(parameters["means"][solid + 1], small) and torch.equal(parameters["means"][1], small)


def test_growth_keeps_to_its_budget_and_takes_the_largest_gradients(gaussians):
    gaussians.seen.fill_(1)
    gaussians.gradient_sum[:] = torch.arange(len(gaussians)) + 1.0  # the sky's is the largest, and does not grow
    solid = gaussians.solid_count
    strongest = gaussians.parameters["sh"][solid - 3 : solid].clone()
    densify.grow(gaussians, 3, torch.Generator().manual_seed(0))
    assert gaussians.solid_count == solid + 3
    assert torch.equal(gaussians.parameters["sh"][solid : solid + 3], strongest)


def test_gaussians_with_small_gradients_do_not_grow(gaussians):
    solid = gaussians.solid_count
    gaussians.seen.fill_(1)
    gaussians.gradient_sum[:3] = torch.tensor([1.9e-4, 2.1e-4, 2.1e-4])  # 3DGS: 2e-4
    densify.grow(gaussians, 100, torch.Generator().manual_seed(0))
    assert gaussians.solid_count == solid + 2


def test_growth_uses_the_mean_gradient_of_a_view_and_resets_the_counts(gaussians):
    solid, seldom = gaussians.solid_count, gaussians.parameters["sh"][0].clone()
    for budget in (1, 0):
        gaussians.seen[:2] = torch.tensor([1.0, 10.0])
        gaussians.gradient_sum[:2] = torch.tensor([2e-3, 3e-3])
        before = gaussians.solid_count
        densify.grow(gaussians, budget, torch.Generator().manual_seed(0))
        assert gaussians.solid_count == before + budget
        assert not gaussians.seen.any() and not gaussians.gradient_sum.any()
    assert torch.equal(gaussians.parameters["sh"][solid], seldom)


def test_halves_of_a_long_gaussian_lie_along_it(gaussians):
    solid, half_turn = gaussians.solid_count, np.deg2rad(40) / 2
    parameters = gaussians.parameters
    parameters["quaternions"][:solid] = torch.tensor([np.cos(half_turn), 0, 0, np.sin(half_turn)]).float()
    parameters["log_scales"][:solid] = torch.tensor([0.1, 1e-6, 1e-6]).log()
    gaussians.gradient_sum[:solid] = 1.0
    before = parameters["means"][:solid].clone()
    densify.grow(gaussians, solid, torch.Generator().manual_seed(0))
    moved = gaussians.parameters["means"][: 2 * solid] - before.repeat(2, 1)
    along = torch.tensor([np.cos(2 * half_turn), np.sin(2 * half_turn), 0]).float()
    assert (moved - (moved @ along)[:, None] * along).norm(dim=1).max() < 1e-5
    assert 0.09 < (moved @ along).std() < 0.11 and not torch.equal(moved[:solid], moved[solid:])


@pytest.mark.parametrize("joined", [0, 5])
def test_growth_that_runs_out_of_memory_changes_nothing(gaussians, monkeypatch, joined):
    """At once, or when some of the tensors have been joined already."""
    gaussians.gradient_sum[:] = 1.0
    gaussians.seen.fill_(1)
    gaussians.parameters["log_scales"][:5] = -1.5  # these would split
    before = {
        name: tensor.clone() for name, tensor in gaussians.tensors().items() if name not in ("gradient_sum", "seen")
    }
    calls = iter([torch.cat] * joined)
    full = failing(torch.OutOfMemoryError("CUDA out of memory"))
    monkeypatch.setattr(torch, "cat", lambda tensors: next(calls, full)(tensors))
    with pytest.raises(torch.OutOfMemoryError):
        densify.grow(gaussians, 5, torch.Generator().manual_seed(0))
    for name, tensor in before.items():
        assert torch.equal(tensor, gaussians.tensors()[name]), name


def test_gaussians_are_allowed_in_the_ball_of_any_point_nearby():
    """Five points close together have small balls; that of the lonely one reaches to them."""
    points = np.zeros((6, 3))
    points[:, 0] = [0.0, 0.01, 0.02, 0.03, 0.04, 1.0]
    means = torch.zeros(4, 3)
    means[:, 0] = torch.tensor([-0.5, 0.02, 0.3, 2.5])
    assert densify.Surroundings(points, reach=1.0).outside(means).tolist() == [True, False, False, True]


def test_points_closer_together_than_most_allow_as_much_around_them_as_others():
    points = np.zeros((15, 3))
    points[:, 0] = [*np.linspace(0, 1e-3, 5), *range(10, 20)]  # most have their fourth neighbour at 2
    means = torch.tensor([[0.0, 3.9, 0.0], [0.0, 4.1, 0.0]])
    assert densify.Surroundings(points, reach=2.0).outside(means).tolist() == [False, True]


def test_points_that_coincide_allow_as_much_around_them_as_those_apart_and_anything_where_all_do():
    points = np.zeros((12, 3))
    points[7:, 0] = range(10, 15)  # of these, most have their fourth neighbour at 3
    means = torch.tensor([[0.0, 2.9, 0.0], [0.0, 3.1, 0.0]])
    assert densify.Surroundings(points, reach=1.0).outside(means).tolist() == [False, True]
    assert not densify.Surroundings(points[:7], reach=1.0).outside(1e6 * means).any()
