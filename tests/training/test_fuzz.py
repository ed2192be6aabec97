"""Losses, Adam and density control on values that no one would draw on purpose."""

import math

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from core.rasterizer.view import view_of
from core.training import guards
from core.training.gaussians import densify
from core.training.gaussians.adam import Moved, adam_rows, plain_adam_rows
from core.training.gaussians.gaussians import Gaussians
from core.training.losses import mask_weights, regularisers
from core.training.losses.mask_loss import mask_loss
from core.training.losses.photometric import Target, photometric, photometric_paper, plain_photometric
from tests.small import ring_camera, small_settings

FINITE = [0.0, -0.0, 1e-45, -1e-38, 0.5, 1.0, -1e3, 1e9, -1e18, 3e38]
POISON = [float("nan"), float("inf"), float("-inf")]
few = settings(max_examples=40, derandomize=True, deadline=None, database=None)
spots = st.tuples(st.integers(0, 8), st.integers(0, 10), st.integers(0, 2))


def picture(spoilt=()) -> torch.Tensor:
    image = torch.rand(9, 11, 3, generator=torch.Generator().manual_seed(2))
    for spot, value in spoilt:
        image[spot] = value
    return image


@few
@given(
    spoilt=st.lists(st.tuples(spots, st.sampled_from(FINITE + POISON)), max_size=4),
    level=st.sampled_from([None, 0.0, 1.0]),
    function=st.sampled_from([photometric, plain_photometric, photometric_paper]),
)
def test_a_finite_picture_loss_has_a_finite_gradient(spoilt, level, function):
    """And a render that is not finite never has a finite loss: the step is skipped."""
    photo = picture() if level is None else torch.full((9, 11, 3), level)
    image = picture(spoilt).requires_grad_()
    weight = torch.rand(9, 11, generator=torch.Generator().manual_seed(3))
    loss = function(image, Target(photo), weight, 0.2)
    if math.isfinite(float(loss.detach())):
        assert torch.isfinite(image).all()
        loss.backward()
        assert torch.isfinite(image.grad).all()


@few
@given(
    spoilt=st.lists(st.tuples(spots, st.sampled_from(FINITE[:-1])), max_size=4),
    level=st.sampled_from([0.0, 1e-45, 0.3, 1.0]),
    mean=st.sampled_from([0.0, 0.3, 0.59999, 0.6, 1.0]),
    points=st.lists(st.sampled_from([0.0, 1e-30, -3.0, 1e6, 1e18]), min_size=6, max_size=6),
)
def test_the_losses_beside_the_pictures_are_finite(spoilt, level, mean, points):
    mask = torch.full((1, 3, 4), level).requires_grad_()
    photo = torch.zeros(3, 9, 11)
    target = Target(photo.permute(1, 2, 0))
    mask_loss(mask, picture(spoilt), target, 0.05).backward()
    assert torch.isfinite(mask.grad).all()
    weights = mask_weights.pixel_weights(target.to_pixels(mask), torch.tensor(mean))
    assert torch.isfinite(weights).all() and (weights <= 1).all()
    means = torch.tensor(points).view(2, 3)
    rows = regularisers.transient_rows(means, torch.tensor([0.5, 0.05]), mask, view_of(ring_camera(0.0)))
    assert rows.shape == (2,) and not rows[1]  # far too faint, wherever it lies
    residual = torch.tensor(points[:3]).view(1, 1, 3).clamp(-4, 4).requires_grad_()  # bounded by G_phi
    regularisers.residual_norm(residual).backward()
    assert torch.isfinite(residual.grad).all()


@few
@given(
    gradients=st.lists(st.sampled_from([value for f in FINITE for value in (f, -f)]), min_size=1, max_size=30),
    update=st.sampled_from([adam_rows, plain_adam_rows]),
)
def test_adam_stays_finite_and_its_steps_small(gradients, update):
    values, first, second = torch.zeros(1, 1), torch.zeros(1, 1), torch.zeros(1, 1)
    counts, rate = torch.zeros(1, dtype=torch.int32), 0.25
    for gradient in gradients:
        before = values.clone()
        update(
            [Moved(values, first, second, torch.tensor([[gradient]]), torch.tensor([rate]))], counts, torch.tensor([0])
        )
        assert all(torch.isfinite(tensor).all() for tensor in (values, first, second))
        # Kingma & Ba, section 2.1: at most (1 - beta_1) / sqrt(1 - beta_2) rates; float32 squares of denormals are 0.
        assert float((values - before).abs()) <= 3.2 * rate


def test_a_row_that_met_a_huge_gradient_learns_on():
    """Its square, infinite in float32, would stop the row for good."""
    values, first, second = torch.zeros(1, 1), torch.zeros(1, 1), torch.zeros(1, 1)
    counts, rows, rate = torch.zeros(1, dtype=torch.int32), torch.tensor([0]), torch.tensor([0.1])
    for gradient in (3e38, *[1e17] * 50):
        adam_rows([Moved(values, first, second, torch.tensor([[gradient]]), rate)], counts, rows)
    before = values.clone()
    adam_rows([Moved(values, first, second, torch.tensor([[1e17]]), rate)], counts, rows)
    assert float((before - values).abs()) > 1e-3


@few
@given(
    spoilt=st.lists(
        st.tuples(
            st.sampled_from(["means", "quaternions", "log_scales", "logit_opacities", "sh"]),
            st.integers(0, 6),
            st.sampled_from(FINITE + POISON),
        ),
        max_size=6,
    ),
    budget=st.sampled_from([0, 3, 100]),
)  # fmt: skip
def test_density_control_leaves_finite_gaussians_and_keeps_its_budget(spoilt, budget):
    generator = torch.Generator().manual_seed(4)
    parameters = {
        "means": torch.randn(7, 3, generator=generator),
        "quaternions": torch.randn(7, 4, generator=generator),
        "log_scales": torch.full((7, 3), -4.0),
        "logit_opacities": torch.zeros(7),
        "sh": torch.randn(7, 4, 3, generator=generator),
    }
    for name, row, value in spoilt:
        parameters[name][row].view(-1)[0] = value
    gaussians = Gaussians.of(parameters, sky_count=0)
    gaussians.gradient_sum, gaussians.seen = torch.rand(7, generator=generator), torch.ones(7)
    points = np.random.default_rng(0).normal(size=(30, 3))
    densify.prune(gaussians, small_settings(), densify.Surroundings(points, 4.0))
    left = gaussians.solid_count
    densify.grow(gaussians, budget, generator)
    assert left <= gaussians.solid_count <= left + budget
    for name, tensor in gaussians.tensors().items():
        assert torch.isfinite(tensor).all(), name


@few
@given(
    known=st.lists(st.sampled_from([None, 0.0, 1e-30, 0.2, 1.9]), min_size=1, max_size=6),
    loss=st.sampled_from([0.0, 0.2, 1.9, 2.1, 30.0, 1e30, *POISON]),
    gauge=st.sampled_from([0.0, 1e3, *POISON]),
)
def test_no_loss_within_the_range_of_photos_is_a_spike(known, loss, gauge):
    usual, tensor = guards.LastLosses(known).usual, torch.tensor(loss)
    sound = bool(guards.sound(tensor + gauge, tensor, torch.tensor(guards.largest_loss(usual))))
    fault = guards.fault(guards.StepFacts(loss + gauge, loss, 0.0, 1.0, sound, True, True), usual)
    if not math.isfinite(loss + gauge):
        assert fault == "loss was not finite"
    elif loss < 2 or known == [None] * len(known):
        assert fault is None
    elif loss >= 20:
        assert "spike" in fault
