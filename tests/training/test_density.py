"""Density control on its way through a run."""

import pytest
import torch

from core.training.gaussians.densify import STIFFEST
from tests.small import trained_to_the_end


def test_the_cap_always_holds(trainer_of):
    assert max(report.gaussians for report in trainer_of(max_gaussians=150).train()) <= 150


def test_the_budget_grows_from_a_quarter_of_the_cap_to_all_of_it(trainer_of):
    trainer = trainer_of(steps=40, densify_rounds=4, max_gaussians=600)
    rounds = trainer.density.grow_at
    for number, step in enumerate(rounds, 1):
        trainer.gaussians.gradient_sum.fill_(1.0)
        trainer.gaussians.seen.fill_(1.0)
        trainer.density.grow(trainer.gaussians, step, useless=0)
        assert trainer.gaussians.solid_count <= round(600 * (0.25 + 0.75 * number / len(rounds))), number
    assert trainer.gaussians.solid_count == 600


def test_growth_does_not_replace_what_no_photo_needs(trainer_of, monkeypatch):
    monkeypatch.setattr("core.training.schedule.LONG_GROWTH", 0)
    trainer = trainer_of(steps=40, densify_rounds=4, max_gaussians=600, prune_contribution=0.5)
    gaussians, state, left = trainer.gaussians, trainer.state, []

    def but_every_third(splats, *_):
        return (torch.arange(len(splats)) % 3).clamp(max=1)

    monkeypatch.setattr("core.training.density.largest_contributions", but_every_third)
    for state.done in trainer.density.grow_at:
        gaussians.gradient_sum.fill_(1.0)
        gaussians.seen.fill_(1.0)
        trainer.density.change(gaussians, state)
        left.append((gaussians.solid_count, state.useless))
    assert left == [(262, 0), (375, 0), (488 - 125, 125), (600 - 246, 246)]


def test_veils_are_removed_once_when_gaussians_have_settled(trainer_of, monkeypatch):
    asked = []

    def first_two(splats, photos, points, rasterizer, progress):
        asked.append((trainer.state.done, len(photos), len(points)))
        return torch.arange(len(splats)) < 2

    monkeypatch.setattr("core.training.density.veils", first_two)
    trainer = trainer_of(steps=20, prune_contribution=0.0, densify_until=0.2)
    gaussians = {report.step: report.gaussians for report in trainer.train()}
    assert asked == [(14, len(trainer.photos), len(trainer.collection.points))]
    assert gaussians[14] == gaussians[13] - 2


@pytest.mark.parametrize(
    "changes, mask_mean, fewest, asked",
    [
        ({}, 0.9, 4, True),
        ({}, 0.9, 5, False),  # more photos than there are
        ({"remove_passers_by": False}, 0.9, 4, False),
        ({"transients": "off"}, 1.0, 4, False),
        ({"mask_apply": 0.9}, 0.9, 4, False),  # nothing is hidden yet
        ({}, 0.5, 4, False),  # masks hide the place itself
    ],
)
def test_passers_by_are_removed_where_masks_can_be_trusted(trainer_of, monkeypatch, changes, mask_mean, fewest, asked):
    seen = []

    def first_two(splats, photos, rasterizer):
        seen.extend(photos)
        return torch.arange(len(splats)) < 2

    monkeypatch.setattr("core.training.density.passers_by", first_two)
    monkeypatch.setattr("core.training.decisions.FEWEST_FOR_MASKS", fewest)
    trainer = trainer_of(steps=20, **changes)
    before = trainer.gaussians.solid_count
    trainer.density.clear_the_view(trainer.gaussians, trainer.density.settled_at, mask_mean)
    assert trainer.gaussians.solid_count == before - 2 * asked
    assert [camera for camera, _ in seen] == trainer.photos.cameras * asked
    assert all(mask.ndim == 3 and not mask.requires_grad for _, mask in seen)


def test_no_gaussian_is_left_thinner_than_viewers_can_draw(trainer_of):
    trainer = trained_to_the_end(trainer_of(steps=30, scale_rate=0.4))
    scales = trainer.gaussians.splats.log_scales[: trainer.gaussians.solid_count]
    stiffest = float((scales.amax(dim=1) - scales.amin(dim=1)).exp().max())
    assert stiffest == pytest.approx(STIFFEST, rel=1e-4)  # without the limit some are
