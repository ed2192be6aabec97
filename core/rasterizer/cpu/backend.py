"""The contract on a CPU: checks, memory, the order of the kernels, and torch's autograd."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from core.errors import BadInput
from core.rasterizer import inputs, layout
from core.rasterizer.contract import BLACK, Colour, Rasterizer, Visible
from core.rasterizer.cpu.bin import SLOT, fill_lists, front_to_back, running_starts
from core.rasterizer.cpu.blend_backward import blend_backward
from core.rasterizer.cpu.blend_forward import blend_forward
from core.rasterizer.cpu.project import colour_footprints, find_visible, project
from core.rasterizer.cpu.project_backward import project_backward
from core.rasterizer.cpu.view import View
from core.rasterizer.shares import Shares, shares_of_slots
from core.scene.camera import Camera
from core.scene.splats import Splats
from core.system.device import array_of
from core.system.threads import in_parallel, threads

# A Gaussian in a tile costs 12 bytes in the forward pass (entry, drawn chunks) and 36 in the backward one (slot).
BYTES_PER_PAIR = 12 + 4 * layout.SLOT_COLUMNS
MEMORY_BUDGET = 4 << 30  # bytes for all tile lists of one picture
NOTHING = np.empty((0, 2), dtype=np.float32)
ROWS_PER_BLOCK = 2048  # Gaussians that a thread takes at a time
MOST_BLOCKS = 64  # of Gaussians that are projected: each counts for itself how many touch each tile


class CpuRasterizer(Rasterizer):
    """Numba kernels on core.system.threads.threads() threads; float32. See `contract.Rasterizer` for the methods."""

    name, device = "cpu", "cpu"

    def visible(self, splats: Splats, camera: Camera) -> Visible:
        arrays = arrays_of(splats)
        flags = np.empty(len(splats), dtype=np.bool_)
        view = View.of(camera)
        in_parallel(lambda *block: find_visible(*block, *arrays, *view, flags), len(flags), ROWS_PER_BLOCK)
        rows = np.flatnonzero(flags)
        return Visible(torch.from_numpy(rows), tile_lists(arrays, rows, NOTHING, camera))

    def render(
        self,
        splats: Splats,
        camera: Camera,
        background: Colour = BLACK,
        probe: Float[Tensor, "n 2"] | None = None,
        known: "TileLists | None" = None,
    ) -> Float[Tensor, "h w 3"]:
        inputs.check(splats, probe, self.name, self.device)
        return _Render.apply(camera, background, probe, known, *splats.tensors().values())

    def contributions(self, splats: Splats, camera: Camera, known: "TileLists | None" = None) -> Float[Tensor, " n"]:
        lists = coloured_lists(arrays_of(splats), NOTHING, camera, known)
        strongest = np.zeros(len(lists.entries), dtype=np.float32)
        draw(lists, camera, BLACK, strongest)
        largest = np.zeros(len(splats), dtype=np.float32)
        np.maximum.at(largest, lists.owners(), strongest)
        return torch.from_numpy(largest)

    def shares(self, splats: Splats, camera: Camera, weight: Float[Tensor, "h w"]) -> Shares:
        lists = coloured_lists(arrays_of(splats), NOTHING, camera)
        image = draw(lists, camera, BLACK)

        def colour_gradients(image_gradient: Tensor) -> Tensor:
            gradients = gradients_of_slots(lists, image, array_of(image_gradient))[:, layout.SUM_COLOUR]
            gradients[lists.drawn_chunks == 0] = 0
            return torch.from_numpy(gradients)

        owners, tiles = torch.from_numpy(lists.owners()), torch.from_numpy(lists.tiles())
        return shares_of_slots(weight, len(splats), owners, tiles, colour_gradients)


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx, camera, background, probe, known, *parameters):
        arrays = [array_of(tensor) for tensor in parameters]
        lists = coloured_lists(arrays, NOTHING if probe is None else array_of(probe), camera, known)
        image = torch.from_numpy(draw(lists, camera, background))
        ctx.camera, ctx.lists, ctx.probed = camera, lists, probe is not None
        ctx.save_for_backward(image, *parameters)
        return image

    @staticmethod
    @once_differentiable
    def backward(ctx, image_gradient):
        image, *parameters = ctx.saved_tensors
        lists = ctx.lists
        slot_gradients = gradients_of_slots(lists, array_of(image), array_of(image_gradient))
        arrays = [array_of(tensor) for tensor in parameters]
        gradients = [torch.empty_like(tensor, memory_format=torch.contiguous_format) for tensor in parameters]
        probe_gradient = torch.empty(len(arrays[0]) if ctx.probed else 0, 2)
        outputs = [gradient.numpy() for gradient in (*gradients, probe_gradient)]
        slots = lists.footprints, lists.slot_starts, lists.drawn_chunks, slot_gradients
        *seen, _ = View.of(ctx.camera)  # without its size
        in_parallel(
            lambda *rows: project_backward(*rows, *arrays, *seen, *slots, *outputs), len(arrays[0]), ROWS_PER_BLOCK
        )
        return None, None, probe_gradient if ctx.probed else None, None, *gradients


# --------------------------------------------------------------------------------------------------------- forward pass


@dataclass
class TileLists:
    """What lies between projection and blending, kept for the backward pass.

    footprints: (N, layout.FOOTPRINT_COLUMNS) float32, set where Gaussians touch a tile. slot_starts: (N + 1,) int64.
    tile_starts: (tiles + 1,) int64. entries: (pairs, 2) int32, Gaussian and slot. drawn_chunks: (pairs,) uint32, of
    each slot, as `blend_forward` has them, zeros before; none as long as the footprints have no colours.
    """

    footprints: np.ndarray
    slot_starts: np.ndarray
    tile_starts: np.ndarray
    entries: np.ndarray
    drawn_chunks: np.ndarray

    def owners(self) -> np.ndarray:
        """(pairs,) int64: the Gaussian of each slot."""
        return np.repeat(np.arange(len(self.footprints)), np.diff(self.slot_starts))

    def tiles(self) -> np.ndarray:
        """(pairs,) int64: the tile of each slot."""
        tiles = np.empty(len(self.entries), dtype=np.int64)
        tiles[self.entries[:, SLOT]] = np.repeat(np.arange(len(self.tile_starts) - 1), np.diff(self.tile_starts))
        return tiles


def coloured_lists(
    arrays: list[np.ndarray], probe: np.ndarray, camera: Camera, known: TileLists | None = None
) -> TileLists:
    """The `tile_lists` of all these Gaussians, or those that are `known`, ready to be drawn once: in their colours."""
    means, *_, sh = arrays
    lists = tile_lists(arrays, np.arange(len(means)), probe, camera) if known is None else known
    if len(lists.footprints) != len(means):
        raise BadInput(
            f"{len(means)} Gaussians were given with what is known of {len(lists.footprints)}.",
            "Give those that are visible.",
        )
    footprints = np.empty_like(lists.footprints)
    given = means, sh, View.of(camera).centre, lists.slot_starts, lists.footprints, footprints
    in_parallel(lambda *block: colour_footprints(*block, *given), len(means), ROWS_PER_BLOCK)
    return replace(lists, footprints=footprints, drawn_chunks=np.zeros(len(lists.entries), dtype=np.uint32))


def tile_lists(arrays: list[np.ndarray], rows: np.ndarray, probe: np.ndarray, camera: Camera) -> TileLists:
    """Project these rows of the Gaussians and sort them into tiles, front to back.
    arrays: in the order of Splats' fields."""
    view, count = View.of(camera), len(rows)
    tiles = layout.tiles_along(camera.width) * layout.tiles_along(camera.height)
    footprints = np.empty((count, layout.FOOTPRINT_COLUMNS), dtype=np.float32)
    depths = np.empty(count, dtype=np.float32)
    tile_counts = np.empty(count, dtype=np.int32)
    *geometry, _ = arrays
    given = rows, *geometry, probe, *view, footprints, depths, tile_counts
    block = max(ROWS_PER_BLOCK, -(-count // MOST_BLOCKS))
    loads = np.zeros((-(-count // block), tiles), dtype=np.int32)
    in_parallel(lambda begin, end: project(begin, end, *given, loads[begin // block]), count, block)
    slot_starts = running_starts(tile_counts)
    tile_starts = running_starts(np.sum(loads, axis=0, dtype=np.int64))
    pairs = int(slot_starts[-1])
    inputs.check_lists(count, pairs, BYTES_PER_PAIR, MEMORY_BUDGET, camera)
    entries = np.empty((pairs, 2), dtype=np.int32)
    order = front_to_back(depths, tile_counts)
    lists = order, footprints, slot_starts, tile_starts, view.size, entries
    in_parallel(lambda half, _: fill_lists(half == 1, *lists), 2, 1)
    return TileLists(footprints, slot_starts, tile_starts, entries, np.empty(0, dtype=np.uint32))


def draw(lists: TileLists, camera: Camera, background: Colour, strongest: np.ndarray | None = None) -> np.ndarray:
    """The picture (height, width, 3), float32.

    strongest: zeros (pairs,) float32, to become the largest alpha * transmittance of each slot.
    """
    image = np.empty((camera.height, camera.width, 3), dtype=np.float32)
    colour = tuple(np.float32(channel) for channel in background)
    if strongest is None:
        strongest = np.empty(0, dtype=np.float32)
    sorted_into_tiles = lists.tile_starts, lists.entries, lists.footprints
    outputs = image, lists.drawn_chunks, strongest
    on_all_tiles(lists, lambda *walk: blend_forward(*walk, *sorted_into_tiles, colour, *outputs))
    return image


def gradients_of_slots(lists: TileLists, image: np.ndarray, image_gradient: np.ndarray) -> np.ndarray:
    """(pairs, SLOT_COLUMNS) float32, set where chunks were drawn: see `blend_backward`.
    image: as `draw` made it of these lists."""
    slot_gradients = np.empty((len(lists.entries), layout.SLOT_COLUMNS), dtype=np.float32)
    blended = lists.tile_starts, lists.entries, lists.footprints, lists.drawn_chunks
    on_all_tiles(lists, lambda *walk: blend_backward(*walk, *blended, image, image_gradient, slot_gradients))
    return slot_gradients


def on_all_tiles(lists: TileLists, work: Callable[[np.ndarray, int, int], None]) -> None:
    """Run work(taken, first, step) on all threads at once,
    each of which walks through the tiles from a `first` of its own.

    They walk in pairs, one toward the other. A Gaussian's slots lie side by side in memory: threads that take
    neighbouring tiles write to the same cache lines, and two then spent a fifth more time than one.
    """
    walkers, taken = threads(), np.zeros(len(lists.tile_starts) - 1, dtype=np.int64)
    pairs = (walkers + 1) // 2

    def walk(number: int, _: int) -> None:
        pair, backwards = divmod(number, 2)
        border = len(taken) * (pair + backwards) // pairs
        work(taken, border - backwards, -1 if backwards else 1)

    in_parallel(walk, walkers, 1)


def arrays_of(splats: Splats) -> list[np.ndarray]:
    """The parameters as the kernels take them, in the order of Splats' fields."""
    inputs.check(splats, None, "cpu", "cpu")
    return [array_of(tensor) for tensor in splats.tensors().values()]
