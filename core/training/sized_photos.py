"""The photos of a training, each decoded once, and their targets."""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from functools import partial

import cv2
import numpy as np
import torch

from core.appearance.encoder import mask_shape
from core.data.collection import Photo
from core.data.photos.file import fault_of
from core.errors import BadInput
from core.report import QUIET, Report
from core.run.sized_photo import SizedPhoto, Sizes, as_tensors, load_sized_photo
from core.scene.camera import Camera
from core.system import memory
from core.system.device import CPU
from core.system.process import blocks_apart, return_freed
from core.system.threads import mapped_in_parallel, threads
from core.training.losses.canvas import TargetOnCanvas
from core.training.losses.photometric import Target
from core.words import Reasons

USUAL_SHARE = 0.5  # of the photos; given masks that leave less may be inverted
DECODERS = 8  # threads at most
DECODED_BYTES = 40  # that a thread takes for each pixel of a file with transparency; for those of others, up to 13
PHOTOS_PER_DECODER = 8  # between two reports of progress
TARGET_BYTES = 3_000_000_000  # cached targets in main memory; beyond, the oldest are made again when needed
LEAST_FILLED = 0.4  # of a canvas, by the mean photo: upright and wide ones together fill three quarters, panoramas less
TARGET_SHARE = 0.25  # of the memory that there is, or of a GPU's, that cached targets may take


class SizedPhotos(Sequence[SizedPhoto]):
    """Photos of one split at training size, and their targets at the coarse-to-fine size of the moment.

    notes: lines to warn of photos left out for damage that shows only now that they are decoded, and of doubtful masks.
    device: of the encoder's inputs and the targets. transparent_is_empty: as `load_photo` has it. share_canvas: whether
    targets are to be laid on one, see `canvas`: False until whoever trains on them sets it.
    """

    def __init__(
        self,
        photos: tuple[Photo, ...],
        sizes: Sizes,
        device: torch.device = CPU,
        transparent_is_empty: bool = False,
        report: Report = QUIET,
    ):
        self.device, self.share_canvas = device, False
        load = partial(load_sized_photo, sizes=sizes, device=device, transparent_is_empty=transparent_is_empty)
        # Blocks apart take twice the time, so they are for a limit, which counts the gaps in the heap.
        with blocks_apart() if memory.limit() else nullcontext():
            self.photos, damage = _usable(photos, load, report)
        return_freed()
        self.notes = damage + _doubtful_masks(self.photos)
        self._targets: OrderedDict[int, Target] = OrderedDict()  # by index, all shrunk by `_factor`
        self._factor = 0
        self._canvases: dict[int, tuple[int, int] | None] = {}
        self._bytes = 0
        self._most_bytes = _most_bytes(device)

    def __len__(self) -> int:
        return len(self.photos)

    def __getitem__(self, index: int) -> SizedPhoto:  # type: ignore[override]  # nobody slices it
        return self.photos[index]

    @property
    def cameras(self) -> list[Camera]:
        """The photos' cameras at training size."""
        return [sized.camera for sized in self.photos]

    def canvas(self, factor: int) -> tuple[int, int] | None:
        """Height and width (px) of what all photos fit on when shrunk by `factor`. None where they share no canvas: if
        they are not asked to, and where photos would leave most of it empty.
        """
        if not self.share_canvas:
            return None
        if factor not in self._canvases:
            sizes = np.array([_shrunk(sized.camera, factor) for sized in self.photos])
            width, height = sizes.max(axis=0).tolist()
            self._canvases[factor] = (
                (height, width) if sizes.prod(axis=1).mean() >= LEAST_FILLED * height * width else None
            )
        return self._canvases[factor]

    def target(self, index: int, factor: int) -> tuple[Camera, Target]:
        """The photo as a training target, shrunk by `factor`, and its camera at that size."""
        camera = self.photos[index].camera
        if factor != self._factor:  # it only changes from coarse to fine: the smaller targets are not needed again
            self._targets.clear()
            self._factor, self._bytes = factor, 0
        if index not in self._targets:
            self._targets[index] = self._made_target(index, factor)
            self._bytes += self._targets[index].nbytes
            while self._bytes > self._most_bytes and len(self._targets) > 1:
                self._bytes -= self._targets.popitem(last=False)[1].nbytes
        return camera.resized(*_shrunk(camera, factor)), self._targets[index]

    def _made_target(self, index: int, factor: int) -> Target:
        sized = self.photos[index]
        pixels, valid, empty, size = sized.pixels, sized.valid, sized.empty, _shrunk(sized.camera, factor)
        if factor > 1:
            pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
            if valid is not None:
                cover = cv2.resize(valid.astype(np.float32), size, interpolation=cv2.INTER_AREA)
                # Where nothing is covered by half, what is covered most.
                valid = cover > (0.5 if cover.max() > 0.5 else cover.max() / 2)
            if empty is not None:
                empty = cv2.resize(empty, size, interpolation=cv2.INTER_AREA)
        shown = as_tensors(pixels, valid, self.device)
        if canvas := self.canvas(factor):
            return TargetOnCanvas(*shown, canvas, mask_shape(sized.encoder_input))
        return Target(*shown, None if empty is None else torch.from_numpy(empty).to(self.device).float() / 255)


def _usable(
    photos: Sequence[Photo], load: Callable[[Photo], SizedPhoto], report: Report
) -> tuple[list[SizedPhoto], list[str]]:
    """The photos that `load` can decode, in their order, and lines about the others."""
    usable: list[SizedPhoto] = []
    damaged, last_fault = Reasons(), ""
    largest_px = max((photo.camera.width * photo.camera.height for photo in photos), default=1)
    decoders = min(threads(), DECODERS, memory.fitting(DECODED_BYTES * largest_px))
    at_once = decoders * PHOTOS_PER_DECODER
    for start in range(0, len(photos), at_once):
        some = photos[start : start + at_once]
        for photo, found in zip(some, _decoded(some, load, decoders), strict=True):
            if isinstance(found, SizedPhoto):
                usable.append(found)
            else:
                fault = fault_of(photo.name, photo.path, found)
                # All masks may be black, and the line would be long.
                shown = "likewise" if fault == last_fault else fault
                damaged.add(f"of the {photo.split} split that cannot be used", f"{photo.name} ({shown})")
                last_fault = fault
        report.progress("Photos", start + len(some), len(photos), some[-1].name)
    return usable, [note.text for note in damaged.notes()]


def _decoded(
    photos: Sequence[Photo], load: Callable[[Photo], SizedPhoto], decoders: int
) -> list[SizedPhoto | BadInput]:
    """What `load` returns or raises for each photo, in their order. decoders: threads at most."""

    def decode(photo: Photo) -> SizedPhoto | BadInput:
        try:
            return load(photo)
        except BadInput as problem:
            return problem

    return mapped_in_parallel(decode, photos, most=decoders)


def _shrunk(camera: Camera, factor: int) -> tuple[int, int]:
    """Width and height (px) of a photo shrunk by `factor`."""
    return max(1, camera.width // factor), max(1, camera.height // factor)


def _doubtful_masks(photos: list[SizedPhoto]) -> list[str]:
    """A line where the masks that the user gave leave little of the photos they belong to."""
    left = [1.0 if sized.valid is None else sized.valid.mean() for sized in photos if sized.photo.mask]
    if not left or np.mean(left) >= USUAL_SHARE:
        return []
    what = f"The masks leave {np.mean(left):.0%} of their photos: white is what is used."
    return [f"{what} Invert them if it marks what is not."]


def _most_bytes(device: torch.device) -> float:
    """What cached targets may take."""
    if device.type == "cuda":
        return TARGET_SHARE * torch.cuda.get_device_properties(device).total_memory
    room = memory.room()
    return TARGET_BYTES if room is None else min(TARGET_BYTES, TARGET_SHARE * room)
