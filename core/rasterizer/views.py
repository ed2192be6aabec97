"""What many views together say of each Gaussian."""

from collections.abc import Callable, Collection, Iterable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from core.rasterizer.contract import Rasterizer
from core.scene.camera import Camera
from core.scene.splats import Splats


def largest_contributions(
    splats: Splats,
    cameras: Collection[Camera],
    rasterizer: Rasterizer,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Float[Tensor, " n"]:
    """The largest contribution alpha T of each Gaussian to any pixel of any view, in [0, 1]; it does not depend on the look.

    RadSplat, section 4.2, calls it the importance score. progress: called with the views done and their number.
    """
    largest = torch.zeros(len(splats), device=splats.means.device)
    for number, camera in enumerate(cameras, start=1):
        torch.maximum(largest, rasterizer.contributions(splats, camera), out=largest)
        progress(number, len(cameras))
    return largest


def largest_shares(splats: Splats, cameras: Iterable[Camera], rasterizer: Rasterizer) -> Float[Tensor, " n"]:
    """The largest share of a whole picture that each Gaussian makes up in any view, in [0, 1]; it does not depend on the look."""
    largest = torch.zeros(len(splats), device=splats.means.device)
    for camera in cameras:
        torch.maximum(largest, shares_of_picture(splats, camera, rasterizer), out=largest)
    return largest


def shares_of_picture(splats: Splats, camera: Camera, rasterizer: Rasterizer, where: Bool[Tensor, "h w"] | None = None) -> Float[Tensor, " n"]:
    """The share of the whole picture that each Gaussian makes up, of all its pixels or of those `where` it is asked for, in [0, 1]."""
    weight = splats.means.new_ones(camera.height, camera.width) if where is None else where.to(splats.means.dtype)
    return rasterizer.shares(splats, camera, weight).of_gaussians() / weight.numel()
