"""Pruning a look: nothing that a training view shows may go, and what may go does go."""

import pytest
import torch

import core.rasterizer
from core.looks.pruning import HALF_STEP, Pruner
from core.rasterizer import BLACK
from core.scene.harmonics import dc_of_colour
from core.scene.splats import Splats
from core.training.trainer import Trainer
from tests.small import ring_camera, small_collection, small_settings, trained_to_the_end

CAMERAS = [ring_camera(angle) for angle in (0.0, 0.4, 0.8)]
RASTERIZER = core.rasterizer.create("cpu")


def gaussians(means, scale: float, opacity: float, colour: float, degree: int = 0) -> Splats:
    count = len(means)
    sh = torch.zeros(count, (degree + 1) ** 2, 3)
    sh[:, 0] = dc_of_colour(torch.full((count, 3), colour))
    quaternions = torch.zeros(count, 4)
    quaternions[:, 0] = 1
    return Splats(
        means=torch.as_tensor(means, dtype=torch.float32),
        quaternions=quaternions,
        log_scales=torch.full((count, 3), scale).log(),
        logit_opacities=torch.logit(torch.full((count,), opacity)),
        sh=sh,
    )


def ball(count: int, degree: int = 0, colour: float = 0.5) -> Splats:
    """What the cameras look at."""
    generator = torch.Generator().manual_seed(1)
    return gaussians(0.3 * torch.randn(count, 3, generator=generator), 0.05, 0.8, colour, degree)


def largest_change(before: Splats, after: Splats) -> float:
    pictures = [[RASTERIZER.render(splats, camera).clamp(0, 1) for splats in (before, after)] for camera in CAMERAS]
    return max(float((first - second).abs().max()) for first, second in pictures)


def test_gaussians_that_no_view_draws_are_removed_without_changing_a_bit():
    seen = ball(200)
    behind = gaussians([[0.0, 0.0, -40.0], [0.0, 0.0, -50.0]], 0.1, 0.9, 1.0)  # behind every camera
    faint = gaussians(torch.zeros(50, 3), 0.1, 0.5 / 255, 1.0)  # below the weakest contribution that is drawn
    look = Splats.concatenate([behind, seen, faint])
    pruned = Pruner(look, CAMERAS, RASTERIZER)(look)
    assert pruned.gaussians >= 52 and len(pruned.splats) == len(look) - pruned.gaussians
    assert pruned.largest == largest_change(look, pruned.splats) * 255 == 0.0


def test_the_sky_stays_whole():
    """Who looks where no photo did would see holes in it."""
    look = Splats.concatenate([ball(200), gaussians([[0.0, 0.0, -40.0], [0.0, 0.0, -50.0]], 0.1, 0.9, 1.0)])
    for sky in (0, 1, 2):
        assert Pruner(look, CAMERAS, RASTERIZER, sky).kept[-2:].tolist() == [sky == 2, sky > 0]


def hidden(count: int) -> Splats:
    """Gaussians in the middle of an opaque ball: each all but invisible, all together not."""
    shell = torch.nn.functional.normalize(torch.randn(3000, 3, generator=torch.Generator().manual_seed(2)), dim=1)
    inside = gaussians(torch.zeros(count, 3), 0.02, 0.02, 1.0)
    return Splats.concatenate([inside, gaussians(0.5 * shell, 0.06, 0.3, 0.1)])


@pytest.mark.parametrize("count", [1, 30, 300])
def test_faint_gaussians_are_removed_while_their_sum_stays_below_half_a_step(count):
    look = hidden(count)
    pruner = Pruner(look, CAMERAS, RASTERIZER)
    pruned = pruner(look)
    drawn, gone = pruner.drawn[:count].sum(), (pruner.drawn & ~pruner.kept)[:count].sum()
    assert 0 < gone <= drawn and (gone < drawn) == (count == 300)
    assert largest_change(look, pruned.splats) <= HALF_STEP
    assert pruned.largest == pytest.approx(largest_change(look, pruned.splats) * 255)
    assert max(float(RASTERIZER.render(look.marked(~pruner.kept), camera).max()) for camera in CAMERAS) <= HALF_STEP


def test_an_sh_band_is_removed_only_if_no_view_shows_it():
    look = ball(200, degree=2)
    look.sh[:, 4:] = 0.001  # times at most 1.1 a coefficient: far below half a step over five of them
    look.sh[:, 1] = 0.2
    pruned = Pruner(look, CAMERAS, RASTERIZER)(look)
    assert pruned.splats.degree == 1 and pruned.bands == 1
    assert 0 < pruned.largest <= 0.5
    assert pruned.largest == pytest.approx(largest_change(look, pruned.splats) * 255)
    look.sh[7, 6] = 1.0  # a single Gaussian needs it
    assert Pruner(look, CAMERAS, RASTERIZER)(look).splats.degree == 2


def test_a_look_too_bright_for_the_bound_keeps_all_that_is_drawn():
    look = hidden(30)
    pruner = Pruner(look, CAMERAS, RASTERIZER)
    assert pruner.kept.sum() < pruner.drawn.sum()
    bright = look.with_sh(look.sh.clone())
    bright.sh[pruner.drawn & ~pruner.kept] = 1e4
    pruned = pruner(bright)
    assert len(pruned.splats) == pruner.drawn.sum() and pruned.largest == 0
    assert largest_change(bright, pruned.splats) == 0


def test_the_bound_holds_over_what_the_look_is_shown_over():
    """A black one behind is nothing over black; over white its absence adds to that of the band."""
    front, behind = (
        gaussians([[0.0, 0.0, 0.0]], 0.3, 0.9, 0.1, degree=1),
        gaussians([[0.0, 0.0, 0.5]], 0.05, 4.5 / 255, 0.0, degree=1),
    )
    front.sh[:, 2] = -0.004
    look, white = Splats.concatenate([front, behind]), (1.0, 1.0, 1.0)
    for background, bands in ((BLACK, 1), (white, 0)):
        pruned = Pruner(look, CAMERAS[:1], RASTERIZER, background=background)(look)
        assert (pruned.gaussians, pruned.bands) == (1, bands)
        shown = [RASTERIZER.render(splats, CAMERAS[0], background).clamp(0, 1) for splats in (look, pruned.splats)]
        assert (
            pruned.largest == pytest.approx(255 * float((shown[0] - shown[1]).abs().max()))
            and 0.3 < pruned.largest <= 0.5
        )


def test_gaussians_that_are_not_finite_are_left_for_the_writer_to_count():
    look = ball(20)
    look.means[3] = torch.nan
    assert Pruner(look, CAMERAS, RASTERIZER).kept[3]


def test_where_no_view_shows_anything_all_is_kept():
    look = gaussians([[0.0, 0.0, -40.0]], 0.1, 0.9, 1.0)
    assert len(Pruner(look, CAMERAS, RASTERIZER)(look).splats) == 1


def test_looks_of_a_trained_scene_keep_the_same_gaussians_within_the_bound(tmp_path):
    collection = small_collection(tmp_path)
    trainer = trained_to_the_end(Trainer(collection, small_settings(sh_degree=2), tmp_path))
    splats, cameras = trainer.gaussians.splats, [sized.camera for sized in trainer.photos]
    pruner = Pruner(splats, cameras, trainer.rasterizer)
    for index in range(2):
        look = trainer.model.bake(splats, trainer.model.read(trainer.photos[index].encoder_input, index).embedding)
        pruned = pruner(look)
        assert 0 < pruned.gaussians < len(look)
        assert torch.equal(pruned.splats.means, splats.means[pruner.kept])
        for camera in cameras:
            before, after = (trainer.rasterizer.render(one, camera).clamp(0, 1) for one in (look, pruned.splats))
            assert (before - after).abs().max() <= HALF_STEP


def test_views_are_skipped_once_nothing_can_go():
    """In most runs training has removed what no photo shows, and a collection may have thousands of views."""
    look, told = ball(200)[:1], []
    views = [ring_camera(0.0)] * 5
    pruner = Pruner(look, views, RASTERIZER, on_progress=lambda done, total: told.append((done, total)))
    assert told == [(5, 5)] and pruner.kept.all()
    behind = gaussians([[0.0, 0.0, -40.0]], 0.1, 0.9, 1.0)
    told.clear()
    assert Pruner(
        Splats.concatenate([look, behind]),
        views,
        RASTERIZER,
        on_progress=lambda done, total: told.append((done, total)),
    ).kept.tolist() == [
        True,
        False,
    ]
    assert told == [(done, 5) for done in range(1, 6)]
