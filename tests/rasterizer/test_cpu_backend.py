"""The CPU backend: threads, what is known of a view, the probe, and refusals."""

from functools import partial

import pytest
import torch

from core.errors import BadInput
from core.rasterizer import create
from core.rasterizer.inputs import check
from core.scene.splats import Splats
from tests.rasterizer.backends import picture_and_gradients
from tests.rasterizer.scenes import camera, cloud
from tests.rasterizer.tolerances import FLIPPED_PIXEL, PICTURE


@pytest.fixture(scope="module")
def scene():
    """Enough for several blocks of Gaussians and dozens of tiles, so that threads really share."""
    view = camera(150, 110, focal=120.0)
    return cloud(view, 3000, seed=50, degree=2, sizes_px=(0.5, 12.0)), view


results = partial(picture_and_gradients, create("cpu"))


def test_any_number_of_threads_gives_the_same_bits(scene, on_threads, monkeypatch):
    splats, view = scene
    monkeypatch.setattr("core.rasterizer.cpu.backend.ROWS_PER_BLOCK", 256)

    def everything():
        found = results(splats, view, torch.zeros(len(splats), 2, requires_grad=True))
        return found + [create("cpu").contributions(splats, view), create("cpu").visible(splats, view).rows]

    first, *others = on_threads((1, 2, 5, 2), everything)  # twice two: what a thread takes first is chance
    for other in others:
        assert all(torch.equal(a, b) for a, b in zip(first, other, strict=True))


def test_reusing_what_visible_found_changes_no_bit_in_any_look(scene):
    splats, view = scene
    rasterizer = create("cpu")
    visible = rasterizer.visible(splats, view)
    seen = splats[visible.rows]
    assert 100 < len(seen) < len(splats)
    blank = seen.sh.clone()
    blank[::3, 0, 0], blank[1::3, 2, 1] = float("nan"), float("inf")
    for sh in (seen.sh, -seen.sh, blank, seen.sh):  # drawn once or often, what is known stays as it was
        look = seen.with_sh(sh)
        assert all(
            torch.equal(a, b)
            for a, b in zip(results(look, view), results(look, view, known=visible.known), strict=True)
        )
        assert torch.equal(rasterizer.contributions(look, view), rasterizer.contributions(look, view, visible.known))


def test_reusing_what_was_found_for_other_gaussians_is_refused(scene):
    splats, view = scene
    known = create("cpu").visible(splats, view).known
    with pytest.raises(BadInput, match=r"3000 Gaussians were given with what is known of \d+\."):
        create("cpu").render(splats, view, known=known)


def test_probe_moves_the_centres(scene):
    """A probe of (3, -2) px does what moving the principal point by as much does, but for the Jacobian's clamp."""
    splats, view = scene
    probe = torch.tensor([3.0, -2.0]).expand(len(splats), 2)
    shifted = create("cpu").render(splats, view, probe=probe)
    inside = create("cpu").render(splats, view.cropped(-3, 2, view.width, view.height))
    # Splats at the border meet other limits of the Jacobian: leave out what a wide one reaches.
    window = slice(45, -45)
    assert (shifted[window, window] - inside[window, window]).abs().max() < 1e-4


def test_the_background_shows_where_splats_leave_light_through(scene):
    splats, view = scene
    black, white = (create("cpu").render(splats, view, (grey,) * 3) for grey in (0.0, 1.0))
    covered = create("cpu").render(splats.marked(slice(None)), view)
    assert (white - black + covered - 1).abs().max() < 1e-6  # of order 1, rounded


def test_ten_thousand_on_one_pixel_and_the_rest_of_the_picture():
    """One tile holds all of them; the picture is right everywhere."""
    view = camera(3, 3, focal=4.0)
    crowd = cloud(view, 10_000, seed=18, degree=0, sizes_px=(0.5, 1.0), opacities=(0.005, 0.02), spread=0.2)
    truth = create("reference").render(crowd.map(torch.Tensor.double), view)
    error = (create("cpu").render(crowd, view) - truth).abs().amax(dim=2)
    assert (error <= FLIPPED_PIXEL).all() and (error > PICTURE).sum() <= 1  # of nine pixels one may be at a threshold

    wide = camera(80, 64, focal=4.0, cx=view.cx, cy=view.cy)
    few = cloud(wide, 100, seed=19, degree=0, depths=(5.0, 9.0))
    alone, together = (create("cpu").render(each, wide) for each in (few, Splats.concatenate([crowd, few])))
    assert torch.equal(alone[:, 40:], together[:, 40:]) and alone[:, 40:].any()


def test_shapes_that_do_not_fit_are_refused():
    """Kernels do not look where they read. (jaxtyping would say so too, but runs under pytest only.)"""
    splats = cloud(camera(), 5, seed=52)
    splats.quaternions = splats.quaternions[:4]
    with pytest.raises(BadInput, match=r"quaternions has the shape \(4, 4\). 5 means ask for \(5, 4\)"):
        check(splats, None, "cpu", "cpu")
