"""The CPU backend as a citizen of torch: threads, autograd, memory layouts, refusals."""

import pytest
import torch

from core.errors import BadInput
from core.rasterizer import create
from core.rasterizer.cpu.backend import CpuRasterizer
from core.rasterizer.inputs import check
from core.scene.splats import Splats
from tests.rasterizer.scenes import camera, cloud
from tests.rasterizer.tolerances import FLIPPED_PIXEL, PICTURE


@pytest.fixture(scope="module")
def scene():
    """Enough for several blocks of Gaussians and dozens of tiles, so that threads really share."""
    view = camera(150, 110, focal=120.0)
    return cloud(view, 3000, seed=50, degree=2, sizes_px=(0.5, 12.0)), view


def results(splats, view, probe=None, known=None):
    splats = splats.map(lambda tensor: tensor.detach().requires_grad_())
    image = create("cpu").render(splats, view, (0.2, 0.5, 0.1), probe, known)
    inputs = list(splats.tensors().values()) + ([] if probe is None else [probe])
    gradients = torch.autograd.grad((image**3).sum(), inputs)
    return [image.detach(), *gradients]


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


def test_memory_layout_does_not_matter(scene):
    splats, view = scene
    strided = splats.map(lambda tensor: torch.stack([tensor, tensor + 1], dim=-1)[..., 0])
    assert not strided.sh.is_contiguous()
    assert all(torch.equal(a, b) for a, b in zip(results(splats, view), results(strided, view), strict=True))


def test_inputs_are_not_changed(scene):
    splats, view = scene
    before = splats.map(torch.clone)
    results(splats, view)
    assert all(torch.equal(a, b) for a, b in zip(before.tensors().values(), splats.tensors().values(), strict=True))


def test_a_single_gradient_can_be_computed_alone_and_twice(scene):
    splats, view = scene
    all_gradients = results(splats, view)
    coefficients = splats.sh.clone().requires_grad_()
    loss = (create("cpu").render(splats.with_sh(coefficients), view, (0.2, 0.5, 0.1)) ** 3).sum()
    first, second = (torch.autograd.grad(loss, coefficients, retain_graph=True)[0] for _ in range(2))
    assert torch.equal(first, second)
    assert torch.equal(first, all_gradients[-1])


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


@pytest.mark.parametrize("name", ["means", "quaternions", "log_scales", "logit_opacities", "sh", "probe"])
def test_other_dtypes_and_devices_are_refused_by_name(name):
    view = camera()
    inputs = cloud(view, 5, seed=51).tensors() | {"probe": torch.zeros(5, 2)}
    for wrong in (inputs[name].double(), inputs[name].to("meta")):
        changed = inputs | {name: wrong}
        probe = changed.pop("probe")
        splats = Splats(**changed)
        with pytest.raises(BadInput, match=f"got {name} as .* Give it float32 on the CPU"):
            CpuRasterizer().render(splats, view, probe=probe)
        if name != "probe":
            for method in (CpuRasterizer().visible, CpuRasterizer().contributions):
                with pytest.raises(BadInput, match=f"got {name} as"):
                    method(splats, view)


def test_shapes_that_do_not_fit_are_refused():
    """Kernels do not look where they read. (jaxtyping would say so too, but runs under pytest only.)"""
    splats = cloud(camera(), 5, seed=52)
    splats.quaternions = splats.quaternions[:4]
    with pytest.raises(BadInput, match=r"quaternions has the shape \(4, 4\). 5 means ask for \(5, 4\)"):
        check(splats, None, "cpu", "cpu")
