"""The CUDA backend: lists, room for them, the probe, and refusals. On a GPU, or by Triton's interpreter."""

import sys
from functools import partial

import numpy as np
import pytest
import torch

import core.rasterizer
from core.errors import BadInput, BadSetting
from core.rasterizer.layout import TILE
from core.rasterizer.view import view_of
from core.scene.splats import Splats
from tests.rasterizer.backends import device_of, picture_and_gradients
from tests.rasterizer.scenes import camera, cloud
from tests.rasterizer.test_cpu_lists import check_tiles, scene

pytest.importorskip("triton", reason="Triton is not installed")

from core.rasterizer.cuda import backend, bin
from core.training.gaussians import chosen_rows_cuda

DEVICE = device_of("cuda")
VIEW = camera(20, 17)


@pytest.fixture
def splats() -> Splats:
    return cloud(VIEW, 12, seed=50, degree=2, sizes_px=(0.5, 8.0)).map(lambda tensor: tensor.to(DEVICE))


def results(splats, view=VIEW, **given):
    return picture_and_gradients(backend.CudaRasterizer(), splats, view, **given)


def lists_of(splats, view):
    return backend.prepare([tensor.to(DEVICE) for tensor in splats.tensors().values()], None, view)


@pytest.fixture(scope="module")
def listed():
    """The scene of the CPU's lists, with one splat as large as itself; and the lists."""
    splats, view = scene()
    splats.log_scales[7] = 5.0
    return splats, view, lists_of(splats, view)


def test_tiles_hold_all_pixels_that_a_splat_reaches_and_few_others(listed):
    _, view, prepared = listed
    lists, drawn = prepared.lists, torch.nonzero(prepared.tile_counts).flatten()
    check_tiles(
        view,
        *(tensor.numpy(force=True) for tensor in (prepared.footprints, drawn, lists.tile_starts, lists.entry_splats)),
    )


def test_lists_are_front_to_back_and_slots_belong_to_their_gaussians(listed):
    splats, view, prepared = listed
    lists = prepared.lists
    depths = (splats.means.double().numpy() - view.centre) @ view.world_to_camera[2]
    assert len(lists.owners) > 400
    for begin, end in zip(lists.tile_starts, lists.tile_starts[1:]):
        assert (np.diff(depths[lists.entry_splats[begin:end].cpu()]) >= 0).all()
    assert torch.equal(lists.entry_slots.sort().values.cpu(), torch.arange(len(lists.owners)))
    counts = prepared.tile_counts[lists.order].long()
    assert torch.equal(lists.slot_starts.diff(), counts)
    assert torch.equal(lists.owners.long(), torch.repeat_interleave(lists.order, counts))


def test_equal_depths_keep_their_order_and_the_culled_come_last():
    depths = torch.tensor([2.0, 1.0, float("inf"), 2.0, 1.0, 1.0])
    order, slot_starts = bin.front_to_back(depths, torch.tensor([1, 2**31 - 1, 0, 1, 2**31 - 1, 3], dtype=torch.int32))
    assert order.tolist() == [1, 4, 5, 0, 3, 2]
    assert slot_starts.tolist() == [0, 2**31 - 1, 2**32 - 2, 2**32 + 1, 2**32 + 2, 2**32 + 3, 2**32 + 3]  # no wrapping


def test_pictures_of_more_than_8_megapixels_have_keys_of_32_bits():
    """One splat in the last of 33,024 tiles: a key of 16 bits would be negative."""
    view = camera(128 * TILE, 258 * TILE, focal=100.0)
    splats = cloud(view, 1, seed=3, sizes_px=(1.0, 1.0), spread=0.0)
    moved = camera(view.width, view.height, focal=100.0, cx=view.width - 3.0, cy=view.height - 3.0)
    prepared = lists_of(splats, moved)
    starts = prepared.lists.tile_starts
    assert len(starts) == 128 * 258 + 1
    assert (starts[:-1].sum(), starts[-1]) == (0, 1)


def test_knowing_the_number_of_pairs_beforehand_changes_nothing(splats):
    """`visible` counts the pairs of a tile and a Gaussian exactly; more room than a look needs is left empty."""
    rasterizer = backend.CudaRasterizer()
    visible = rasterizer.visible(splats, VIEW)
    seen = splats[visible.rows]
    pairs = visible.known.pairs
    assert pairs == len(lists_of(seen, VIEW).lists.owners) > 0
    expected, largest = results(seen), rasterizer.contributions(seen, VIEW)
    for room in (visible.known, visible.known._replace(pairs=pairs + 7)):
        assert all(torch.equal(a, b) for a, b in zip(results(seen, known=room), expected, strict=True))
        assert torch.equal(rasterizer.contributions(seen, VIEW, room), largest)


def test_a_small_picture_whose_tiles_are_divided_is_the_same(monkeypatch):
    """Tiles in three sections, in nine and eight parts, and in as many as there are."""
    few = backend.interpreted()
    view = camera(30, 13 if few else 27, focal=40.0)
    count, sizes_px, tiles = (48, (6.0, 24.0), 2) if few else (160, (2.0, 12.0), 4)
    splats = cloud(view, count, seed=51, degree=1, sizes_px=sizes_px).map(lambda tensor: tensor.to(DEVICE))
    splats.logit_opacities[: count // 4] = 4.0  # pixels are finished in different sections
    monkeypatch.setattr(backend, "PROGRAMS", 1)
    image, *gradients = results(splats, view=view)
    for programs in (3, 9, 50):
        monkeypatch.setattr(backend, "PROGRAMS", programs * tiles)
        divided, *others = results(splats, view=view)
        assert torch.equal(image, divided)
        # What lies behind a section is a difference of sums, and not one less another.
        for gradient, other in zip(gradients, others, strict=True):
            torch.testing.assert_close(other, gradient, rtol=1e-4, atol=1e-6 * float(gradient.abs().max()))


def test_more_room_than_a_view_needs_changes_nothing(splats):
    """Room for Gaussians is filled with rows of -1, that for pixels with the background."""
    rasterizer = backend.CudaRasterizer()
    visible, background = rasterizer.visible(splats, VIEW), (0.2, 0.5, 0.1)
    count, pairs = len(visible.rows), visible.known.pairs
    size, room = (VIEW.height + 3, VIEW.width + 21), backend.Room(count + 5, pairs + 7)
    within, needed = rasterizer.visible_within(splats, view_of(VIEW).to(DEVICE), size, room)
    assert needed.tolist() == [count, pairs] and within.rows.tolist() == visible.rows.tolist() + [-1] * 5
    seen = Splats(**chosen_rows_cuda.chosen_rows(splats.tensors(), within.rows))
    image = rasterizer.render(seen, VIEW, background, None, within.known)
    assert torch.equal(image[: VIEW.height, : VIEW.width], rasterizer.render(splats, VIEW, background))
    beyond = torch.ones(image.shape[:2], dtype=torch.bool, device=DEVICE)
    # Tiles at the rim may show what sticks out.
    beyond[: -(-VIEW.height // TILE) * TILE, : -(-VIEW.width // TILE) * TILE] = False
    assert (image[beyond] == torch.tensor(background, device=DEVICE)).all()


def test_too_little_room_is_reported(splats):
    rasterizer = backend.CudaRasterizer()
    visible = rasterizer.visible(splats, VIEW)
    room = backend.Room(len(visible.rows) // 2, visible.known.pairs // 3)
    within, needed = rasterizer.visible_within(splats, view_of(VIEW).to(DEVICE), (VIEW.height, VIEW.width), room)
    assert needed.tolist() == [len(visible.rows), visible.known.pairs] and len(within.rows) == room.gaussians
    image = rasterizer.render(splats[within.rows], VIEW, known=within.known)
    assert image.isfinite().all()


def test_a_probe_of_zeros_changes_nothing_and_one_of_pixels_moves_the_centres(splats):
    probe = torch.zeros(len(splats), 2, device=DEVICE)
    assert all(torch.equal(a, b) for a, b in zip(results(splats), results(splats, probe=probe), strict=True))
    probe[:] = torch.tensor([3.0, -2.0])
    prepared = [backend.prepare(list(splats.tensors().values()), given, VIEW) for given in (None, probe)]
    both = (prepared[0].tile_counts > 0) & (prepared[1].tile_counts > 0)
    moved = (prepared[1].footprints - prepared[0].footprints)[both, :2]
    assert both.any() and (moved - probe[both]).abs().max() < 1e-5  # centres of up to 30 px, rounded


@pytest.mark.parametrize("degree, most", [(3, 2**31 // 48), (0, 2**31 // 12)])
def test_more_gaussians_than_kernels_can_count_are_refused_by_every_method(degree, most):
    """Of degree 0 the footprints are the largest array. All Gaussians are one in memory."""
    rasterizer, one = (
        backend.CudaRasterizer(),
        cloud(VIEW, 1, seed=50, degree=degree).map(lambda tensor: tensor.to(DEVICE)),
    )
    splats = one.map(lambda tensor: tensor.expand(most + 1, *tensor.shape[1:]))
    shares = partial(rasterizer.shares, weight=torch.ones(17, 20, device=DEVICE))
    for use in (rasterizer.visible, rasterizer.render, rasterizer.contributions, shares):
        with pytest.raises(
            BadInput, match=rf"{most + 1} Gaussians of SH degree {degree} are more than .*--max-gaussians"
        ):
            use(splats, VIEW)


def test_as_many_gaussians_as_kernels_can_count_are_drawn(monkeypatch, splats):
    monkeypatch.setattr(backend, "MOST_NUMBERS", splats.sh.numel() + 1)
    assert backend.CudaRasterizer().render(splats, VIEW.cropped(7, 5, 6, 7)).any()  # a picture of fewer numbers


def test_a_picture_of_more_numbers_than_kernels_can_count_is_refused(splats):
    """Before there is any room for it: kernels would write beside it."""
    view = camera(26_755, 26_755)
    with pytest.raises(BadInput, match="26755x26755 px is larger than the cuda rasterizer can count"):
        backend.CudaRasterizer().render(splats, view)


def test_a_missing_gpu_or_triton_is_reported_in_one_line(monkeypatch):
    monkeypatch.setattr(backend, "interpreted", lambda: False)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(BadSetting, match="needs an NVIDIA GPU"):
        core.rasterizer.create("cuda")
    for module in [module for module in sys.modules if module.startswith("core.rasterizer.cuda")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "triton", None)  # as if it were not installed
    with pytest.raises(BadSetting, match="needs Triton, which is not installed"):
        core.rasterizer.create("cuda")
