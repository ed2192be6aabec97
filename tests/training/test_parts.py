"""The parts of training, one by one."""

import os

import numpy as np
import pytest
import torch

from core.errors import BadInput
from core.scene.quaternions import rotations
from core.system import atomic, lock
from core.training import guards, schedule
from core.training.gaussians import densify
from core.training.gaussians.adam import Moved, adam_rows, plain_adam_rows
from core.training.gaussians.gaussians import Gaussians
from core.training.gaussians.initialisation import initial_gaussians
from core.training.losses import mask_weights, regularisers
from core.training.losses.backward import backward
from core.training.on_disk import checkpoint, run_folders
from tests.small import ring_camera, small_collection, small_settings, whole_settings


@pytest.fixture
def gaussians(tmp_path) -> Gaussians:
    settings = small_settings()
    return initial_gaussians(small_collection(tmp_path), settings, torch.Generator().manual_seed(1))


# --- Adam


def test_adam_equals_torch_where_every_row_is_seen():
    torch.manual_seed(0)
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
    torch.manual_seed(0)
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


# --- density control


def test_pruning_removes_the_faint_the_huge_and_the_broken_but_never_the_sky(gaussians):
    solid, sky = gaussians.solid, gaussians.sky
    gaussians.parameters["logit_opacities"][0] = -20
    gaussians.parameters["log_scales"][1] = 5
    gaussians.parameters["means"][2] = float("nan")
    densify.prune(gaussians, small_settings())
    assert (gaussians.solid, gaussians.sky) == (solid - 3, sky)
    assert all(len(tensor) == len(gaussians) for tensor in gaussians.tensors().values())


def test_a_broken_gaussian_goes_also_where_the_distance_to_points_is_asked(gaussians):
    points = gaussians.parameters["means"][: gaussians.solid].double().numpy()
    gaussians.parameters["means"][0] = float("nan")
    gaussians.parameters["means"][1] = 50.0
    densify.prune(gaussians, small_settings(), densify.Surroundings(points, reach=4.0))
    assert gaussians.solid == len(points) - 2


@pytest.mark.parametrize("reaching", [0.0, 0.1, 0.5, 1.0])
def test_a_quarter_stays_whatever_it_contributes_and_no_more_than_that_of_the_faint(gaussians, reaching):
    solid, means = gaussians.solid, gaussians.parameters["means"].clone()
    largest = torch.zeros(len(gaussians))
    largest[: round(reaching * solid)] = torch.linspace(0.15, 0.05, round(reaching * solid))
    strong = int((largest >= 0.1).sum())
    densify.prune_by_contribution(gaussians, largest, 0.1)
    quarter = solid - int(0.75 * solid)
    assert gaussians.solid == max(strong, quarter) and gaussians.sky == len(means) - solid
    assert torch.equal(gaussians.parameters["means"][: gaussians.solid], means[: gaussians.solid])  # the strongest
    gaussians.keep(torch.zeros(len(gaussians), dtype=torch.bool))
    densify.prune_by_contribution(gaussians, torch.zeros(len(gaussians)), 0.1)
    assert gaussians.solid == 0


@pytest.mark.parametrize("gather", [densify.gather, densify.plain_gather])
def test_what_pulls_at_the_seen_is_gathered_in_half_pictures_unless_the_step_is_dropped(gaussians, gather):
    rows, pulls = torch.tensor([1, 4, 5]), torch.tensor([[3.0, 0.0], [0.0, -2.0], [0.6, 0.4]])
    for taken in (True, True, False):
        gather(gaussians, rows, pulls if taken else pulls * float("nan"), 20, 30, torch.tensor(taken))
    assert gaussians.seen[:6].tolist() == [0, 2, 0, 0, 2, 2]
    expected = torch.tensor([0, 60, 0, 0, 60, 2 * 72**0.5])  # hypot(0.6 * 10, 0.4 * 15) = sqrt(72)
    torch.testing.assert_close(gaussians.gradient_sum[:6], expected)


def test_growth_clones_the_small_and_splits_the_large(gaussians):
    solid = gaussians.solid
    gaussians.seen.fill_(1)
    gaussians.gradient_sum[:2] = 1.0
    gaussians.parameters["log_scales"][0] = np.log(0.5)
    gaussians.parameters["log_scales"][1] = np.log(0.001)
    small = gaussians.parameters["means"][1].clone()
    densify.grow(gaussians, 100, torch.Generator().manual_seed(0))
    parameters = gaussians.parameters
    assert gaussians.solid == solid + 2
    expected = torch.full((3,), 0.5 / 1.6)
    torch.testing.assert_close(parameters["log_scales"][0].exp(), expected)
    torch.testing.assert_close(parameters["log_scales"][solid].exp(), expected)
    assert torch.equal(parameters["means"][solid + 1], small) and torch.equal(parameters["means"][1], small)


def test_growth_keeps_to_its_budget_and_takes_the_strongest_pull(gaussians):
    gaussians.seen.fill_(1)
    gaussians.gradient_sum[: gaussians.solid] = torch.arange(gaussians.solid) + 1.0
    solid = gaussians.solid
    strongest = gaussians.parameters["sh"][solid - 3 : solid].clone()
    densify.grow(gaussians, 3, torch.Generator().manual_seed(0))
    assert gaussians.solid == solid + 3
    assert torch.equal(gaussians.parameters["sh"][solid : solid + 3], strongest)


def test_growth_asks_for_the_mean_pull_of_a_view_and_counts_afresh(gaussians):
    solid, seldom = gaussians.solid, gaussians.parameters["sh"][0].clone()
    for budget in (1, 0):
        gaussians.seen[:2] = torch.tensor([1.0, 10.0])
        gaussians.gradient_sum[:2] = torch.tensor([2e-3, 3e-3])
        before = gaussians.solid
        densify.grow(gaussians, budget, torch.Generator().manual_seed(0))
        assert gaussians.solid == before + budget
        assert not gaussians.seen.any() and not gaussians.gradient_sum.any()
    assert torch.equal(gaussians.parameters["sh"][solid], seldom)


def test_what_a_long_gaussian_splits_into_lies_along_it(gaussians):
    solid, half_turn = gaussians.solid, np.deg2rad(40) / 2
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


def test_growth_that_finds_no_memory_changes_nothing(gaussians, monkeypatch):
    gaussians.gradient_sum[:] = 1.0
    gaussians.seen.fill_(1)
    gaussians.parameters["log_scales"][:5] = -1.5  # these would split
    before = {name: tensor.clone() for name, tensor in gaussians.tensors().items() if name not in ("gradient_sum", "seen")}

    def full(*_, **__):
        raise torch.OutOfMemoryError("CUDA out of memory")

    monkeypatch.setattr(torch, "cat", full)
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


def test_the_skys_discs_face_the_scene(gaussians):
    sky = gaussians.splats[gaussians.solid :]
    outwards = torch.nn.functional.normalize(sky.means, dim=1)
    torch.testing.assert_close(rotations(sky.quaternions)[:, :, 2], outwards, rtol=0, atol=1e-5)
    assert (sky.log_scales.argmin(dim=1) == 2).all()


# --- losses


def test_the_residuals_norm_passes_gradcheck():
    residual = torch.randn(5, 4, 3, generator=torch.Generator().manual_seed(0)).double()
    assert torch.autograd.gradcheck(regularisers.residual_norm, residual.requires_grad_())


def test_collapsed_masks_are_raised_to_the_floor():
    mask = torch.full((1, 5, 5), 0.2)
    assert float(mask_weights.pixel_weights(mask, 20, 20, mask_mean=0.2).mean()) == pytest.approx(mask_weights.COLLAPSED)
    assert float(mask_weights.pixel_weights(mask, 20, 20, mask_mean=0.9).mean()) == pytest.approx(0.2)


def test_transient_rows_are_those_in_front_inside_the_mask():
    camera = ring_camera(0.0)
    means = torch.tensor([[-0.8, 0.0, 0.0], [0.8, 0.0, 0.0], [-0.8, 0.0, 0.0], [0.0, 0.0, -9.0], [50.0, 0.0, 0.0]])
    mask = torch.ones(1, 9, 12)
    mask[:, :, :6] = 0  # the left half of the picture
    rows = regularisers.transient_rows(means, torch.tensor([0.9, 0.9, 0.01, 0.9, 0.9]), mask, camera)
    assert rows.tolist() == [True, False, False, False, False]
    beside = torch.zeros(200, 3)
    beside[:, 0] = torch.linspace(-4.0, 0.0, 200)
    shown = torch.from_numpy(camera.project(beside.double().numpy())[0][:, 0] >= 0)
    assert 0 < int(shown.sum()) < 200 - 10  # some lie less than a cell of the mask beyond the edge
    assert torch.equal(regularisers.transient_rows(beside, torch.ones(200), torch.zeros(1, 9, 12), camera), shown)


@pytest.mark.parametrize("where", ["cpu", "meta"])
def test_gradients_that_are_not_finite_are_found(where):
    """As a CPU looks for them, and as a GPU does; of a view of nothing they have no numbers."""
    where = torch.device(where)
    good = [torch.ones(3), None, torch.zeros(0, 4), torch.full((2,), -1e30)]
    assert guards.finite(good, where)
    for bad in (torch.nan, torch.inf, -torch.inf):
        assert not guards.finite([*good, torch.tensor([1.0, bad])], where)
    assert guards.finite([torch.zeros(0)], torch.device("cpu"))


# --- schedules


def test_schedules_are_fractions_of_the_steps():
    short, long = whole_settings(steps=100), whole_settings(steps=100_000)
    assert schedule.densification_steps(long)[-1] == 1000 * schedule.densification_steps(short)[-1]
    assert [schedule.shrink_factor(short, progress) for progress in (0.0, short.coarse_until * 0.6, 0.9)] == [4, 2, 1]
    assert schedule.evenly(4, 100) == {25, 50, 75, 100}
    assert schedule.contribution_steps(short) == {65, 85}
    through = [schedule.time_through(short, step) for step in range(101)]
    times = np.diff(through)
    assert (through[0], through[-1]) == (0.0, pytest.approx(1.0))
    assert times[5] / times[50] == pytest.approx(1 / 3) and times[15] / times[50] == pytest.approx(1 / 2)
    late = whole_settings(steps=100, densify_until=0.9)
    assert min(schedule.contribution_steps(late)) > schedule.densification_steps(late)[-1]


# --- checkpoints


def test_the_newest_checkpoint_is_the_one_of_the_highest_step(tmp_path):
    for name in ("000400", "999999", "1000000"):
        (tmp_path / f"checkpoint_{name}.safetensors").write_text("")
    (tmp_path / "checkpoint_of_yesterday.safetensors").write_text("")
    assert checkpoint.newest(tmp_path).name == "checkpoint_1000000.safetensors"


def test_a_checkpoint_that_cannot_be_written_says_how_to_go_on(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    saved = checkpoint.Checkpoint({"a.b": torch.arange(3)}, {"step": 7})
    checkpoint.save(tmp_path, saved)
    monkeypatch.setattr(checkpoint, "save_file", full)
    with pytest.raises(BadInput, match="No space left.*wegs train --resume -o"):
        checkpoint.save(tmp_path, checkpoint.Checkpoint(saved.tensors, {"step": 8}))
    checkpoint.newest(tmp_path).unlink()
    with pytest.raises(BadInput, match="then type: wegs train --resume -o"):
        checkpoint.save(tmp_path, saved)


@pytest.mark.skipif(lock.fcntl is None, reason="this system has no flock(2)")
def test_what_a_kill_left_of_a_checkpoint_goes_with_the_next_one_or_with_the_run(tmp_path):
    def killed():
        left = tmp_path / f".checkpoint{atomic.TEMPORARY}abc"
        left.mkdir()
        (left / ".tmpxyz").touch()  # safetensors' own
        os.utime(left, (1e9, 1e9))

    killed()
    path = checkpoint.save(tmp_path, checkpoint.Checkpoint({"a.b": torch.arange(3)}, {"step": 7}))
    assert list(tmp_path.iterdir()) == [path]
    killed()
    run_folders.create(tmp_path, small_collection(tmp_path / "scene"), small_settings())
    assert not [*tmp_path.glob(".*"), *tmp_path.glob("checkpoint*")]


def test_a_checkpoint_comes_back_and_a_broken_one_is_refused(tmp_path):
    saved = checkpoint.Checkpoint({"a.b": torch.arange(3)}, {"step": 7})
    path = checkpoint.save(tmp_path, saved)
    assert checkpoint.newest(tmp_path) == path
    loaded = checkpoint.load(path)
    assert torch.equal(loaded.part("a")["b"], torch.arange(3)) and loaded.facts["step"] == 7
    (tmp_path / "other").touch()
    assert path.stat().st_mode == (tmp_path / "other").stat().st_mode  # whoever may read a file may read a checkpoint
    path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(BadInput, match="not a readable checkpoint"):
        checkpoint.load(path)


def test_a_checkpoint_that_the_next_one_replaces_while_it_is_read_is_no_damage(tmp_path):
    def saved(step):
        return checkpoint.save(tmp_path, checkpoint.Checkpoint({"a.b": torch.arange(3)}, {"step": step}))

    first, read = saved(7), []

    def read_late(path):
        read.append(path.name)
        if path == first:
            saved(8)
        return checkpoint.load(path)

    path, found = checkpoint.read_newest(tmp_path, read_late)
    assert found.facts["step"] == 8 and read == [first.name, path.name]
    path.write_bytes(b"")
    with pytest.raises(BadInput, match="not a readable checkpoint"):
        checkpoint.read_newest(tmp_path, checkpoint.load)
    path.unlink()
    assert checkpoint.read_newest(tmp_path, checkpoint.load) is None


def test_backward_from_several_roots_leaves_out_what_has_no_gradient():
    x = torch.tensor([1.0, 2.0], requires_grad=True)
    y = x * 3
    backward((x.sum(), None), (y, torch.tensor([1.0, 10.0])), (None, None), (torch.zeros(()), None), (x * 5, None))
    assert x.grad.tolist() == [4, 31]
    backward((torch.zeros(()), None))  # nothing to do
