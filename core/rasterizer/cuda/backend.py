"""The contract on a GPU: checks, memory, the order of the kernels, and torch's autograd."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from core.errors import BadInput, BadSetting
from core.kernels.triton_launch import FUSED, MOST_NUMBERS, UNFUSED, USE_SMALLER, blocks, interpreted
from core.rasterizer import inputs, layout
from core.rasterizer.contract import BLACK, Colour, Rasterizer, Visible
from core.rasterizer.cuda import blend_backward, blend_forward, project, project_backward
from core.rasterizer.cuda.bin import TileLists, front_to_back, tile_lists
from core.rasterizer.shares import Shares, shares_of_slots
from core.rasterizer.view import view_of
from core.scene.camera import Camera
from core.scene.splats import Splats
from core.system.device import sent

# A Gaussian in a tile costs, in bytes: tile and owner (6), both sorted with the sort's own room (32), the entry's
# Gaussian (4), and in the backward pass the slot, and whether it was blended.
BYTES_PER_PAIR = 43 + 4 * layout.SLOT_COLUMNS
MEMORY_SHARE = 0.5  # of the card, for all tile lists of one picture
MEMORY_INTERPRETED = 4 << 30  # bytes
# Programs of blending that a GPU has room for. Where a picture has fewer tiles, each is divided, into so many parts and
# sections at most.
PROGRAMS = 1 if interpreted() else 8192  # the interpreter runs one after the other
MOST_PARTS, MOST_SECTIONS = 8, 32


class Room(NamedTuple):
    """How many Gaussians there is room for in a view, and how many pairs of a Gaussian and a tile that it touches."""

    gaussians: int
    pairs: int


class Known(NamedTuple):
    """What is known of Gaussians in a view. view: as kernels read it. pairs: of a Gaussian and a tile that it touches,
    how many there are or more. width, height: of the picture, px; it may be larger than what the view shows, which is
    then its upper left corner.
    """

    view: Tensor
    pairs: int
    width: int
    height: int


class CudaRasterizer(Rasterizer):
    """Triton kernels; float32. See `contract.Rasterizer` for the methods.

    The same bits in every run on one kind of card. Under Triton's interpreter it takes tensors on the CPU instead, for
    tests. Raises BadSetting where torch finds no GPU.
    """

    name = "cuda"

    def __init__(self):
        self.device = "cpu" if interpreted() else "cuda"
        if self.device == "cuda" and not torch.cuda.is_available():
            raise BadSetting(
                "The cuda rasterizer needs an NVIDIA GPU, and torch finds none here.", "Leave --backend out."
            )

    def visible(self, splats: Splats, camera: Camera) -> Visible:
        view = view_for_kernels(camera, splats.means.device)
        shown, counts = self._find_visible(splats, view)
        count, pairs = counts.cpu().tolist()  # the host waits for the device
        return Visible(
            torch.nonzero_static(shown, size=count).squeeze(1), Known(view, pairs, camera.width, camera.height)
        )

    def visible_within(
        self, splats: Splats, view: Tensor, shape: tuple[int, int], room: Room
    ) -> tuple[Visible, Int[Tensor, "2"]]:
        """What a view shows, as `visible`, without waiting for the device: as much of it as there is room for.

        view: see `view_of`, on the device. shape: height and width of the picture (px), as large as the view's or
        larger. Of the rows, those that are not needed are -1. Returns also for how many Gaussians and pairs there
        should be room; where there is not, what is drawn is incomplete.
        """
        view = view.float()
        shown, counts = self._find_visible(splats, view)
        rows = torch.nonzero_static(shown, size=room.gaussians, fill_value=-1).squeeze(1)
        height, width = shape
        return Visible(rows, Known(view, room.pairs, width, height)), counts

    def _find_visible(self, splats: Splats, view: Tensor) -> tuple[Int[Tensor, " n"], Int[Tensor, "2"]]:
        """Which Gaussians are not culled, 1 or 0; how many these are, and how many pairs with a tile."""
        found = torch.empty(2, len(splats), dtype=torch.int32, device=view.device)
        project.find_visible[blocks(len(splats), project.BLOCK)](
            *self._parameters(splats), view, found, len(splats),
            COEFFICIENTS=splats.sh.shape[1], BLOCK=project.BLOCK, num_warps=project.WARPS, **UNFUSED,
        )  # fmt: skip
        return found[0], found.sum(dim=1)

    def render(
        self,
        splats: Splats,
        camera: Camera,
        background: Colour = BLACK,
        probe: Float[Tensor, "n 2"] | None = None,
        known: Known | None = None,
    ) -> Float[Tensor, "h w 3"]:
        self._check(splats, probe)
        return _Render.apply(camera, background, probe, known, *splats.tensors().values())

    @torch.no_grad()
    def contributions(self, splats: Splats, camera: Camera, known: Known | None = None) -> Float[Tensor, " n"]:
        prepared = prepare(self._parameters(splats), None, camera, known)
        strongest = torch.zeros(len(prepared.lists.owners), device=splats.means.device)
        draw(prepared, BLACK, strongest)
        # The largest of some numbers is the same in any order: the atomics behind this change nothing.
        largest = torch.zeros(len(splats), device=splats.means.device)
        return largest.scatter_reduce_(0, prepared.lists.owners.long(), strongest, "amax")

    @torch.no_grad()
    def shares(self, splats: Splats, camera: Camera, weight: Float[Tensor, "h w"]) -> Shares:
        prepared = prepare(self._parameters(splats), None, camera)
        lists = prepared.lists
        drawn = draw(prepared, BLACK, differentiable=True)
        tiles = torch.empty_like(lists.entry_slots)
        tiles[lists.entry_slots] = torch.repeat_interleave(lists.tile_starts.diff())

        def colour_gradients(image_gradient: Tensor) -> Tensor:
            gradients, blended_slots = gradients_of_slots(prepared, drawn, image_gradient)
            return torch.where(blended_slots[:, None] != 0, gradients[:, layout.SUM_COLOUR], 0)

        return shares_of_slots(weight, len(splats), lists.owners, tiles, colour_gradients)

    def _parameters(self, splats: Splats) -> list[Tensor]:
        self._check(splats)
        return [tensor.detach().contiguous() for tensor in splats.tensors().values()]

    def _check(self, splats: Splats, probe: Tensor | None = None) -> None:
        inputs.check(splats, probe, self.name, self.device)
        if max(splats.sh.numel(), len(splats) * layout.FOOTPRINT_COLUMNS) >= MOST_NUMBERS:
            raise BadInput(
                f"{len(splats)} Gaussians of SH degree {splats.degree} are more than the "
                f"{self.name} rasterizer can count.",
                "Lower --max-gaussians.",
            )


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx, camera, background, probe, known, *parameters):
        parameters = tuple(tensor.contiguous() for tensor in parameters)
        prepared = prepare(parameters, None if probe is None else probe.contiguous(), camera, known)
        drawn = draw(prepared, background, differentiable=any(ctx.needs_input_grad))
        ctx.prepared, ctx.probed = prepared, probe is not None
        ctx.part_ends, ctx.notes = drawn.part_ends, drawn.notes
        ctx.save_for_backward(drawn.image, *parameters)
        return drawn.image

    @staticmethod
    @once_differentiable
    def backward(ctx, image_gradient):
        image, *parameters = ctx.saved_tensors
        prepared, lists = ctx.prepared, ctx.prepared.lists
        count, device = len(parameters[0]), image.device
        drawn = Drawn(image.detach(), ctx.part_ends, ctx.notes)
        of_slots = gradients_of_slots(prepared, drawn, image_gradient.contiguous())
        sums = torch.empty(count, layout.SLOT_COLUMNS, device=device)
        blend_backward.add_up[blocks(count, blend_backward.BLOCK)](
            lists.order, lists.slot_starts, *of_slots, sums, count, BLOCK=blend_backward.BLOCK, num_warps=1, **UNFUSED
        )
        gradients = [torch.empty_like(tensor, memory_format=torch.contiguous_format) for tensor in parameters]
        probe_gradient = torch.empty(count if ctx.probed else 0, 2, device=device)
        project_backward.project_backward[blocks(count, project_backward.BLOCK)](
            *parameters, prepared.view, prepared.footprints, prepared.tile_counts, sums,
            *gradients, probe_gradient, count,
            COEFFICIENTS=parameters[-1].shape[1], PROBED=ctx.probed, BLOCK=project_backward.BLOCK,
            num_warps=project_backward.WARPS, **UNFUSED,
        )  # fmt: skip
        return None, None, probe_gradient if ctx.probed else None, None, *gradients


# --------------------------------------------------------------------------------------------------------- forward pass


@dataclass
class Prepared:
    """What lies between projection and blending, kept for the backward pass.

    width, height: of the picture, px. footprints: (N, layout.FOOTPRINT_COLUMNS), set where Gaussians touch a tile.
    tile_counts: (N,) int32.
    """

    view: Tensor
    width: int
    height: int
    footprints: Tensor
    tile_counts: Tensor
    lists: TileLists

    @property
    def columns(self) -> int:
        """Tiles across the picture."""
        return layout.tiles_along(self.width)


def prepare(parameters: Sequence[Tensor], probe: Tensor | None, camera: Camera, known: Known | None = None) -> Prepared:
    """Project the Gaussians (contiguous, in the order of Splats' fields) and sort them into tiles, front to back.

    known: as `contract.Visible` has it; without it the host waits for the number of pairs.
    """
    count, device = len(parameters[0]), parameters[0].device
    view = view_for_kernels(camera, device) if known is None else known.view
    width, height = (camera.width, camera.height) if known is None else (known.width, known.height)
    if 3 * width * height >= MOST_NUMBERS:
        what = f"A picture of {width}x{height} px is larger than the cuda rasterizer can count."
        raise BadInput(what, USE_SMALLER)
    footprints = torch.empty(count, layout.FOOTPRINT_COLUMNS, device=device)
    depths = torch.empty(count, device=device)
    tile_counts = torch.empty(count, dtype=torch.int32, device=device)
    project.project[blocks(count, project.BLOCK)](
        *parameters, depths if probe is None else probe, view, footprints, depths, tile_counts, count,
        COEFFICIENTS=parameters[-1].shape[1], PROBED=probe is not None, BLOCK=project.BLOCK,
        num_warps=project.WARPS, **UNFUSED,
    )  # fmt: skip
    order, slot_starts = front_to_back(depths, tile_counts)
    slots = int(slot_starts[-1]) if known is None else known.pairs
    if known is not None:
        slot_starts.clamp_(max=slots)  # no kernel writes beyond its memory, should the caller have drawn something else
    inputs.check_lists(count, slots, BYTES_PER_PAIR, memory_budget(device), camera)
    lists = tile_lists(order, slot_starts, footprints, view, width, height, slots)
    return Prepared(view, width, height, footprints, tile_counts, lists)


class Drawn(NamedTuple):
    """A picture (height, width, 3), and what the backward pass has to know of how it was blended, see `blend_forward`.

    part_ends: (tiles, parts) int64. notes: (tiles, sections, 4, pixels), None where lists are not divided.
    """

    image: Tensor
    part_ends: Tensor
    notes: Tensor | None


def draw(
    prepared: Prepared, background: Colour, strongest: Tensor | None = None, differentiable: bool = False
) -> Drawn:
    """Blend what was prepared. differentiable: whether `gradients_of_slots` is to come.

    strongest: zeros (slots,), to become the largest alpha * transmittance of each slot.
    """
    lists, width, height, device = prepared.lists, prepared.width, prepared.height, prepared.footprints.device
    tiles = len(lists.tile_starts) - 1
    image = torch.empty(height, width, 3, device=device)
    parts = MOST_PARTS if strongest is None and MOST_PARTS * tiles <= PROGRAMS else 1
    sections = max(1, min(MOST_SECTIONS, PROGRAMS // tiles)) if differentiable else 1
    part_ends = torch.empty(tiles, parts, dtype=torch.int64, device=device)
    notes = torch.empty(tiles, sections, 4, layout.TILE**2, device=device) if sections > 1 else None
    # A kernel that is compiled not to use an array is given another in its place, here and elsewhere.
    blend_forward.blend_forward[(part_ends.numel(),)](
        lists.tile_starts, lists.entry_splats, lists.entry_slots, prepared.footprints,
        image, part_ends, image if notes is None else notes, image if strongest is None else strongest,
        sections, prepared.columns, width, height, *map(float, background),
        PARTS=parts, NOTES=notes is not None, RECORD=strongest is not None,
        num_warps=blend_forward.WARPS[parts], **UNFUSED,
    )  # fmt: skip
    return Drawn(image, part_ends, notes)


def gradients_of_slots(prepared: Prepared, drawn: Drawn, image_gradient: Tensor) -> tuple[Tensor, Tensor]:
    """The slots' gradients (slots, SLOT_COLUMNS), and (slots,) uint8, not 0 for those that are set: see
    `blend_backward`. drawn: differentiable."""
    lists, (image, part_ends, notes) = prepared.lists, drawn
    (height, width, _), (tiles, parts) = image.shape, part_ends.shape
    sections = 1 if notes is None else notes.shape[1]
    slot_gradients = torch.empty(len(lists.owners), layout.SLOT_COLUMNS, device=image.device)
    blended_slots = torch.zeros(len(lists.owners), dtype=torch.uint8, device=image.device)
    blend_backward.blend_backward[(tiles, sections)](
        lists.tile_starts, part_ends, image if notes is None else notes,
        lists.entry_splats, lists.entry_slots, prepared.footprints,
        image, image_gradient, slot_gradients, blended_slots, sections, prepared.columns, width, height,
        PARTS=parts, NOTES=notes is not None, num_warps=blend_backward.WARPS, **FUSED,
    )  # fmt: skip
    return slot_gradients, blended_slots


def view_for_kernels(camera: Camera, device: torch.device) -> Tensor:
    """The camera as kernels read it, float32, on `device`."""
    return sent(view_of(camera).float(), device)


def memory_budget(device: torch.device) -> float:
    """The bytes that the tile lists of a picture may take there."""
    if device.type != "cuda":
        return MEMORY_INTERPRETED
    return MEMORY_SHARE * torch.cuda.get_device_properties(device).total_memory
