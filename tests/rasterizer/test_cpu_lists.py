"""Which tiles and chunks a splat is entered in, and in which order, against brute force over all pixels."""

from itertools import pairwise

import numpy as np
from numba import njit

from core.rasterizer import layout
from core.rasterizer.contract import ALPHA_MIN
from core.rasterizer.cpu import backend
from core.rasterizer.cpu.bin import SLOT, SPLAT, front_to_back, running_starts
from core.rasterizer.cpu.blend import ROW_TERMS, touched_chunks, write_row_terms
from core.rasterizer.layout import TILE
from tests.rasterizer.scenes import camera, cloud


def scene():
    """Splats of all shapes and sizes, some far beside the picture, in a picture whose last tiles are cut."""
    view = camera(75, 52, focal=60.0)
    return cloud(view, 300, seed=40, sizes_px=(0.3, 30.0), ratio=1000.0, opacities=(0.004, 0.99), spread=2.0), view


def lists_of(splats, view):
    return backend.coloured_lists(backend.arrays_of(splats), backend.NOTHING, view)


def alphas_of(footprints, x, y):
    """(splats, pixels) in float64 from the footprints: what blending computes."""
    f = footprints.astype(np.float64)[:, :, None]
    dx, dy = x - f[:, layout.X], y - f[:, layout.Y]
    across = f[:, layout.SHARPNESS] * (dx - f[:, layout.SLOPE] * dy)
    return 2 ** (f[:, layout.STRENGTH] - across**2 - f[:, layout.FALL] * dy**2)


def check_tiles(view, footprints, drawn, tile_starts, gaussians):
    """Every tile lists all splats that reach a pixel in it, and few others.

    footprints: of all splats, which of them are `drawn`. tile_starts: where each tile's list begins, and the end.
    gaussians: of the entries.
    """
    y, x = (grid.ravel() for grid in np.mgrid[: view.height, : view.width])
    alphas = alphas_of(footprints[drawn], x + 0.5, y + 0.5)
    columns = -(-view.width // TILE)
    listed = np.zeros((len(footprints), len(tile_starts) - 1), dtype=bool)
    for tile, (begin, end) in enumerate(pairwise(tile_starts)):
        listed[gaussians[begin:end], tile] = True
    reached = np.zeros_like(listed)
    for rank, i in enumerate(drawn):
        # Within a millionth of the threshold either is right.
        reached[i, np.unique((y // TILE * columns + x // TILE)[alphas[rank] >= ALPHA_MIN * (1 + 1e-6)])] = True
    assert (listed | ~reached).all()
    # An ellipse can pass between pixel centres, which adds 1 % here; lists by bounding box would be a third longer.
    assert listed.sum() <= 1.05 * reached.sum()


def test_tiles_hold_all_pixels_that_a_splat_reaches_and_few_others():
    splats, view = scene()
    lists = lists_of(splats, view)
    check_tiles(
        view, lists.footprints, np.flatnonzero(np.diff(lists.slot_starts)), lists.tile_starts, lists.entries[:, SPLAT]
    )


@njit
def chunks_of(footprints, i, centre_x, centre_y):
    terms = np.empty(ROW_TERMS, np.float32)
    write_row_terms(footprints, i, np.float32(centre_x), np.float32(centre_y), terms, 0)
    return touched_chunks(footprints[i, layout.SHARPNESS], terms, 0)


def test_chunks_hold_all_pixels_that_a_splat_reaches_and_no_others():
    splats, view = scene()
    lists = lists_of(splats, view)
    columns = -(-view.width // TILE)
    row, column = (grid.ravel() for grid in np.mgrid[:TILE, :TILE])
    fine = np.linspace(0.5, 7.5, 113)  # positions within a chunk, 1/16 px apart, from its left edge
    extra = missing = total = 0
    for tile in range(len(lists.tile_starts) - 1):
        left, top = tile % columns * TILE, tile // columns * TILE
        for i in lists.entries[lists.tile_starts[tile] : lists.tile_starts[tile + 1], SPLAT]:
            chunks = chunks_of(lists.footprints, i, left + TILE / 2, top + TILE / 2)
            alphas = alphas_of(lists.footprints[i : i + 1], left + column + 0.5, top + row + 0.5)[0]
            for chunk in range(32):
                marked = bool(chunks >> np.uint32(chunk) & np.uint32(1))
                inside = (row == chunk % TILE) & (column // 8 == chunk // TILE)
                # Between the pixel centres too: the ellipse may cross the row there.
                between = left + chunk // TILE * 8 + fine
                peak = alphas_of(lists.footprints[i : i + 1], between, top + chunk % TILE + 0.5).max()
                total += marked
                missing += not marked and alphas[inside].max() >= ALPHA_MIN * (1 + 1e-4)
                extra += marked and peak < ALPHA_MIN * 0.95  # the peak may lie between two samples
    assert total > 1000
    assert missing == 0
    assert extra == 0


def test_lists_are_front_to_back_and_slots_are_used_once():
    splats, view = scene()
    lists = lists_of(splats, view)
    depths = (splats.means.double().numpy() - view.centre) @ view.world_to_camera[2]
    assert len(lists.entries) > 400
    for begin, end in zip(lists.tile_starts, lists.tile_starts[1:]):
        assert (np.diff(depths[lists.entries[begin:end, SPLAT]]) >= 0).all()
    assert np.array_equal(np.sort(lists.entries[:, SLOT]), np.arange(len(lists.entries)))
    owners = np.repeat(np.arange(len(splats)), np.diff(lists.slot_starts))
    assert np.array_equal(owners[lists.entries[:, SLOT]], lists.entries[:, SPLAT])


def test_order_is_a_stable_sort_of_what_is_drawn():
    random = np.random.default_rng(1)
    depths = random.choice(np.float32([0.01, 0.5, 1, 1.0000001, 7, 3e5, 3e38]), 5000).astype(np.float32)
    depths[::3] = random.uniform(0.01, 100, len(depths[::3]))
    tile_counts = random.integers(0, 3, len(depths)).astype(np.int32)
    drawn = np.flatnonzero(tile_counts)
    expected = drawn[np.argsort(depths[drawn], kind="stable")]
    assert np.array_equal(front_to_back(depths, tile_counts), expected)


def test_totals_do_not_wrap_around():
    starts = running_starts(np.full(3, 2**31 - 1, dtype=np.int32))
    assert starts.tolist() == [0, 2**31 - 1, 2**32 - 2, 3 * (2**31 - 1)]
