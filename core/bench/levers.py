"""What a rasterizer can trade for time, with the definition's own functions and in the kernels.

The contract fixes the thresholds, so no backend takes them as arguments. Here the definition is blended tile by tile
with others; and the kernels, which compile them in, are compiled anew with others in a process of their own.
"""

import os
import signal
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from threading import Thread

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from core.bench.figure import Spread
from core.bench.stopwatch import timed
from core.rasterizer import contract, create, reference
from core.scene.camera import Camera
from core.scene.harmonics import MAX_DEGREE, colour
from core.scene.splats import Splats
from core.system.atomic import scratch


@dataclass(frozen=True)
class Levers:
    """alpha_min, stop_transmittance: see the contract. tile_px: side of the tiles that get a list of splats of their own."""

    dtype: torch.dtype = torch.float64
    alpha_min: float = contract.ALPHA_MIN
    stop_transmittance: float = contract.STOP_TRANSMITTANCE
    tile_px: int = 16
    sh_degree: int = MAX_DEGREE


# As good as no thresholds: what is left out are contributions below a thousandth of half an 8-bit step.
UNTHRESHOLDED = Levers(alpha_min=1e-6, stop_transmittance=0.0)


@torch.no_grad()
def draw(splats: Splats, camera: Camera, levers: Levers) -> Float[Tensor, "h w 3"]:
    """The definition's picture over black with these levers; with the contract's, in float64, the definition itself.

    Whatever the threshold, Gaussians whose opacity is below the contract's ALPHA_MIN are culled.
    """
    splats = splats.up_to_degree(levers.sh_degree).map(lambda tensor: tensor.to(levers.dtype))
    splats = splats[reference.can_be_projected(splats, camera)]
    splats = splats[reference.front_to_back(splats, camera)]
    projection = reference.project(splats, camera)
    colours = colour(splats.sh, projection.directions)
    low, high = reference.boxes(projection, levers.alpha_min)
    drawable = reference.is_ellipse(projection)

    image = colours.new_zeros(camera.height, camera.width, 3)
    side = levers.tile_px
    for top in range(0, camera.height, side):
        for left in range(0, camera.width, side):
            width, height = min(side, camera.width - left), min(side, camera.height - top)
            corner = low.new_tensor([left, top])
            size = low.new_tensor([width, height])
            rows = torch.nonzero(((high >= corner) & (low <= corner + size)).all(dim=1) & drawable).squeeze(1)
            arrays = projection.centres[rows], projection.conics[rows], projection.opacities[rows]
            window = camera.cropped(left, top, width, height)
            pictures = []
            for pixels in reference.pixel_chunks(window, len(rows), low):
                thresholds = levers.alpha_min, levers.stop_transmittance
                weights, _ = reference.blend_weights(pixels + corner, *arrays, *thresholds)
                pictures.append(weights @ colours[rows])
            image[top : top + height, left : left + width] = torch.cat(pictures).reshape(height, width, 3)
    return image


def recompiled(
    backend: str, alpha_min: float, stop_transmittance: float, splats: Splats, cameras: list[Camera], budget: float
) -> tuple[list[Float[np.ndarray, "h w 3"]], Spread]:
    """The pictures of a backend that was compiled with other thresholds, and the seconds that all of them take.

    A process of its own, with a cache of its own: compiled kernels hold the constants, and their cache does not know it.
    """
    arrays = {name: tensor.numpy() for name, tensor in splats.tensors().items()}
    with scratch("bench") as cache, ProcessPoolExecutor(1, get_context("spawn")) as process:
        start = process.submit(_set_constants, str(cache), alpha_min, stop_transmittance, torch.get_num_threads())
        start.result()
        return process.submit(_measure_recompiled, backend, arrays, cameras, budget).result()


def _set_constants(cache: str, alpha_min: float, stop_transmittance: float, threads: int) -> None:
    from numba import config

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent reports a Ctrl-C
    Thread(target=_end_with_parent, daemon=True).start()
    config.CACHE_DIR = cache
    contract.ALPHA_MIN, contract.STOP_TRANSMITTANCE = alpha_min, stop_transmittance
    torch.set_num_threads(threads)


def _end_with_parent() -> None:
    """An executor does not notice that its parent was killed: it would wait for work for ever."""
    parent_process().join()
    os._exit(1)


def _measure_recompiled(backend: str, arrays: dict[str, np.ndarray], cameras: list[Camera], budget: float) -> tuple[list[np.ndarray], Spread]:
    rasterizer = create(backend)  # imports the kernels only now
    splats = Splats(**{name: torch.from_numpy(array) for name, array in arrays.items()})
    rasterizer.render(splats, cameras[0])  # compiles, for seconds that no repeat may count
    return timed(lambda: [rasterizer.render(splats, camera).numpy() for camera in cameras], budget)
