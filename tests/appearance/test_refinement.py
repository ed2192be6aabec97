"""Refinement, of a look that is the picture's one colour: its embedding, times the gain of the place."""

import numpy as np
import pytest
import torch

from core.appearance.colouring import Colouring
from core.appearance.refinement import (
    LATER_STEPS,
    LEAST_SKY,
    LONGER_SIDE_PX,
    STEPS,
    RefinementTarget,
    _share_of_cells,
    refinement,
    without_strangers,
)
from core.scene.camera import Camera
from core.scene.cells import CELL_PX
from tests.flat_view import FlatInCells, FlatView

PICTURE = torch.full((4, 6, 3), 0.4)


def camera_of(width: int, height: int) -> Camera:
    return Camera.centred(np.eye(3), np.zeros(3), 500.0, width, height)


def shown(picture, valid=None) -> RefinementTarget:
    return RefinementTarget.of(camera_of(picture.shape[1], picture.shape[0]), picture, valid)


def refined(picture, begin, valid=None, tone=None, **view):
    """The last look, and its colour."""
    *_, last = refinement(FlatView(picture.shape[:2], **view), Colouring(begin, tone), shown(picture, valid))
    return last, FlatView((1, 1)).render(last)[0, 0]


def test_refinement_never_increases_the_loss():
    """It starts so close that Adam's first step leads past the colour by nearly its rate."""
    begin, view = torch.full((3,), 0.4 + 1e-4), FlatView((4, 6))
    steps = list(refinement(view, Colouring(begin), shown(PICTURE)))
    losses = [float((view.render(best) - PICTURE).abs().mean()) for best in steps]
    assert len(steps) == STEPS + 1 and torch.equal(steps[0].embedding, begin) and torch.equal(steps[1].embedding, begin)
    assert losses == sorted(losses, reverse=True) and losses[-1] < 2e-5  # the rate falls to zero


def test_invalid_pixels_do_not_count():
    picture, valid = PICTURE.clone(), torch.ones(4, 6, dtype=torch.bool)
    picture[:, 2:] = 0.9
    valid[:, 2:] = False
    _, colour = refined(picture, torch.full((3,), 0.8), valid)
    assert (colour - 0.4).abs().max() < 0.01


def test_passers_by_count_less_and_another_light_counts_in_full():
    side, begin = 16 * CELL_PX, Colouring(torch.full((3,), 0.4))
    other_light = torch.tensor([0.3, 0.2, 0.1]).expand(side, side, 3)
    assert (without_strangers(FlatView((side, side)), begin, shown(other_light)).weight == 1).all()
    picture, stranger = other_light.clone(), slice(4 * CELL_PX, 7 * CELL_PX)
    picture[stranger, stranger] = torch.tensor([0.1, 0.1, 0.5])
    weight = without_strangers(FlatView((side, side)), begin, shown(picture)).weight
    assert weight.min() >= 0 and weight[stranger, stranger].mean() < 0.05
    weight[3 * CELL_PX : 8 * CELL_PX, 3 * CELL_PX : 8 * CELL_PX] = 1  # and the cells around, as errors are smoothed
    assert (weight == 1).all()


def test_refinement_starts_from_the_tone_that_was_read_and_improves_it():
    begin, tone = torch.full((3,), 0.8), torch.tensor([[0.25, 0.5, 0.5], [0.1, 0.1, 0.1]])
    first = next(refinement(FlatView((4, 6)), Colouring(begin, tone), shown(PICTURE)))
    torch.testing.assert_close(first.tone, tone)
    found, colour = refined(PICTURE, begin, tone=tone)
    assert (colour - 0.4).abs().max() < 0.01 and found.tone[0, 0] > 0.25
    torch.testing.assert_close(found.tone[1], tone[1])  # nothing shows the sky


def test_detail_finer_than_a_cell_does_not_change_a_look():
    """A chequered picture has the colour of its means."""
    side = 4 * CELL_PX
    chequered = torch.full((side, side, 3), 0.4)
    chequered[::2, ::2] = chequered[1::2, 1::2] = 0.9
    _, colour = refined(chequered, torch.full((3,), 0.5))
    assert (colour - 0.65).abs().max() < 1e-3  # by single pixels any colour between the two fits as well


def test_a_photo_that_is_not_too_large_is_compared_as_it_is():
    picture = torch.rand(LONGER_SIDE_PX, 240, 3)
    photo = shown(picture)
    assert photo.camera.height == LONGER_SIDE_PX and photo.picture is picture and (photo.weight == 1).all()


def test_a_larger_photo_is_shrunk_by_area_and_what_is_invalid_does_not_count():
    """Blocks of four pixels, of which none, one, two or all are invalid and of a colour of their own."""
    height, width = 2 * LONGER_SIDE_PX, LONGER_SIDE_PX
    picture, valid = torch.full((height, width, 3), 0.25), torch.ones(height, width, dtype=torch.bool)
    valid[::2, width // 4 :] = False  # two of four
    valid[1::2, width // 2 :] = False  # all
    valid[0, 0] = False  # one
    picture[~valid] = 0.9
    photo = shown(picture, valid)
    camera, weight, half = photo.camera, photo.weight, width // 2
    assert (camera.width, camera.height, camera.fx) == (half, LONGER_SIDE_PX, 250.0) and photo.picture.shape == (
        LONGER_SIDE_PX,
        half,
        3,
    )
    assert (
        weight[0, 0] == 0.75
        and (weight[1:, : half // 4] == 1).all()
        and (weight[:, half // 4 : half // 2] == 0.5).all()
    )
    assert not weight[:, half // 2 :].any()
    counts = weight > 0
    torch.testing.assert_close(photo.picture[counts], torch.full((int(counts.sum()), 3), 0.25))
    assert shown(picture).picture[0, 0, 0] == pytest.approx((0.9 + 3 * 0.25) / 4)


def test_weights_that_embeddings_give_can_go_beyond_what_any_embedding_gives():
    """They learn in units of how widely they differ between looks, so one that hardly differs stays."""
    apart = {"last.bias": torch.tensor([0.5, 0.5, 1e-6])}
    begin = torch.full((3,), 0.8)
    found, colour = refined(PICTURE, begin, given_spread=apart)
    assert (colour - 0.4).abs().max() < 0.01 and torch.equal(found.embedding, begin)
    assert (found.changes["last.bias"][:2] < -0.05).all() and found.changes["last.bias"][2].abs() < 1e-5


def test_weights_that_embeddings_give_learn_on_beside_the_shared_ones_in_the_same_units():
    apart = {"last.bias": torch.tensor([0.5, 0.5, 1e-6])}
    view = FlatView((4, 6), given_spread=apart, hidden={"layers.0.bias": torch.zeros(3)})
    steps = list(refinement(view, Colouring(torch.full((3,), 3.0)), shown(torch.zeros(4, 6, 3))))
    before, after = (steps[number].changes["last.bias"] for number in (STEPS, -1))
    assert (after[:2] < before[:2] - 0.05).all() and after[2].abs() < 1e-4


@pytest.mark.parametrize("as_much, learned", [(0, True), (60, False)])
def test_shared_weights_are_refined_last_unless_that_would_change_the_unseen_more_than_the_seen(as_much, learned):
    """as_much: how many times as far as the picture the colours out of view move. The embedding is bounded, so that
    only the shared weights can fit this picture."""
    view = FlatView(
        (4, 6), bound=lambda embedding: torch.full_like(embedding, 0.9), hidden={"layers.0.bias": torch.zeros(3)}
    )
    view.harmonics = lambda rows, look: (
        as_much * look.changes["layers.0.bias"].expand(len(rows), 1, 3)
        if look.changes
        else torch.zeros(len(rows), 1, 3)
    )
    steps = list(refinement(view, Colouring(torch.full((3,), 0.9)), shown(torch.zeros(4, 6, 3))))
    assert len(steps) == STEPS + LATER_STEPS + 1 and steps[STEPS].changes == {}
    assert torch.equal(steps[-1].tone, steps[STEPS].tone)
    change = steps[-1].changes["layers.0.bias"] if steps[-1].changes else torch.zeros(3)
    assert (change < -0.05).all() if learned else (change == 0).all()


def test_shared_weights_are_refined_last_where_a_photo_shows_all_of_the_place(monkeypatch):
    """Nothing is to be held: a mean over nothing would teach nothing."""
    monkeypatch.setattr(FlatInCells, "unseen", torch.arange(0))
    view = FlatView((4, 6), bound=lambda embedding: torch.full_like(embedding, 0.9), hidden={"bias": torch.zeros(3)})
    *_, last = refinement(view, Colouring(torch.full((3,), 0.9)), shown(torch.zeros(4, 6, 3)))
    assert (last.changes["bias"] < -0.05).all()


def test_refinement_starts_from_weights_that_were_changed_before():
    begin = Colouring(torch.full((3,), 0.9), None, {"last.bias": torch.full((3,), -0.5)})
    first = next(refinement(FlatView((4, 6), given_spread={"last.bias": torch.ones(3)}), begin, shown(PICTURE)))
    assert torch.equal(first.changes["last.bias"], begin.changes["last.bias"])


def test_a_photo_with_few_valid_pixels_is_followed_no_less():
    """What holds the unseen is weighed against the mean over valid pixels, not against their sum."""
    moves = []
    for columns in (1, 6):
        valid = torch.zeros(4, 6, dtype=torch.bool)
        valid[:, :columns] = True
        view = FlatView(
            (4, 6), bound=lambda embedding: torch.full_like(embedding, 0.9), hidden={"layers.0.bias": torch.zeros(3)}
        )
        view.harmonics = lambda rows, look: 4 * sum(look.changes.values(), torch.zeros(3)).expand(len(rows), 1, 3)
        *_, last = refinement(view, Colouring(torch.full((3,), 0.9)), shown(torch.zeros(4, 6, 3), valid))
        moves.append(last.changes["layers.0.bias"])
    assert (moves[0] < -0.05).all()
    torch.testing.assert_close(moves[0], moves[1], rtol=0.01, atol=1e-4)


@pytest.mark.parametrize(
    "columns, weight", [(0, 1.0), (10, 1.0), (20, 1.0), (30, 1 / 3), (39, LEAST_SKY), (40, LEAST_SKY)]
)
def test_the_sky_counts_no_more_than_the_place(columns, weight):
    sky, pixels = torch.zeros(40), torch.full((40,), 64.0)
    sky[:columns] = 64
    weights = _share_of_cells(sky, pixels)
    torch.testing.assert_close(weights[:columns], torch.full((columns,), weight))
    assert (weights[columns:] == 1).all()


def test_invalid_cells_are_no_place_and_cells_that_are_half_sky_count_in_between():
    sky, pixels = torch.zeros(40), torch.full((40,), 64.0)
    sky[:10], sky[10], pixels[14:] = 64, 32, 0
    assert _share_of_cells(sky, pixels)[[0, 10, 11]].tolist() == pytest.approx([1 / 3, 2 / 3, 1])


def test_an_embedding_stays_within_its_bound():
    found, colour = refined(PICTURE, torch.full((3,), 0.8), bound=lambda embedding: embedding.clamp(min=0.7))
    assert found.embedding.min() >= 0.7 and (colour - 0.4).abs().max() < 0.01  # the tone does the rest


@pytest.mark.parametrize("size", [(1, 1), (3, 200), (200, 3)])
def test_pictures_of_any_shape_can_be_refined(size):
    _, colour = refined(torch.full((*size, 3), 0.4), torch.full((3,), 0.5))
    assert (colour - 0.4).abs().max() < 1e-3
