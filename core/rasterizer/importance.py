"""How much of each Gaussian many views show together: what is worth keeping, and what stands in the way."""

from collections.abc import Callable, Collection
from functools import partial

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from core.rasterizer.contract import Rasterizer
from core.scene.camera import Camera
from core.scene.splats import Splats

Progress = Callable[[int, int], None]  # called with the views done and their number


def untold(done: int, total: int) -> None:
    """A Progress that nobody hears of."""


def largest_contributions(splats: Splats, cameras: Collection[Camera], rasterizer: Rasterizer, progress: Progress = untold) -> Float[Tensor, " n"]:
    """The largest contribution alpha T of each Gaussian to any pixel of any view, in [0, 1]; it does not depend on the look.

    RadSplat, section 4.2, calls it the importance score.
    """
    return _largest(rasterizer.contributions, splats, cameras, progress)


def largest_shares(splats: Splats, cameras: Collection[Camera], rasterizer: Rasterizer, progress: Progress = untold) -> Float[Tensor, " n"]:
    """The largest share of a whole picture that each Gaussian makes up in any view, in [0, 1]; it does not depend on the look."""
    return _largest(partial(shares_of_picture, rasterizer=rasterizer), splats, cameras, progress)


def _largest(
    of_view: Callable[[Splats, Camera], Float[Tensor, " n"]], splats: Splats, cameras: Collection[Camera], progress: Progress
) -> Float[Tensor, " n"]:
    """The largest number that any view has for each Gaussian, of those >= 0."""
    largest = torch.zeros(len(splats), device=splats.means.device)
    for number, camera in enumerate(cameras, start=1):
        torch.maximum(largest, of_view(splats, camera), out=largest)
        progress(number, len(cameras))
    return largest


def shares_of_picture(splats: Splats, camera: Camera, rasterizer: Rasterizer, where: Bool[Tensor, "h w"] | None = None) -> Float[Tensor, " n"]:
    """The share of the whole picture that each Gaussian makes up, of all its pixels or of those `where` it is asked for, in [0, 1]."""
    weight = splats.means.new_ones(camera.height, camera.width) if where is None else where.to(splats.means.dtype)
    return rasterizer.shares(splats, camera, weight).of_gaussians() / weight.numel()
