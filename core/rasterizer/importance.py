"""How much each Gaussian contributes to a set of views: which are worth keeping, and which block the view."""

from collections.abc import Callable, Collection

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from core.rasterizer.contract import Rasterizer
from core.report import OnProgress, ignore_progress
from core.scene.camera import Camera
from core.scene.harmonics import SH_0
from core.scene.splats import Splats


def largest_contributions(
    splats: Splats,
    cameras: Collection[Camera],
    rasterizer: Rasterizer,
    on_progress: OnProgress = ignore_progress,
    at_least: Float[Tensor, " n"] | None = None,
    enough: float = torch.inf,
) -> Float[Tensor, " n"]:
    """The largest contribution alpha T of each Gaussian to any pixel of any view, in [0, 1];
    it does not depend on the look.

    RadSplat, section 4.2, calls it the importance score. on_progress: called after each view. at_least: what the result
    is raised to, such as infinity for Gaussians whose score does not matter. enough: scores up to this are
    exact; once all are above, the remaining views are skipped.
    """
    return _largest(rasterizer.contributions, splats, cameras, on_progress, at_least, enough)


def largest_shares(
    splats: Splats, cameras: Collection[Camera], rasterizer: Rasterizer, on_progress: OnProgress = ignore_progress
) -> Float[Tensor, " n"]:
    """The largest share of a whole picture that each Gaussian makes up in any view, in [0, 1];
    it does not depend on the look."""

    def share(splats: Splats, camera: Camera) -> Float[Tensor, " n"]:
        return shares_of_picture(splats, camera, rasterizer)[0]

    return _largest(share, splats, cameras, on_progress)


def _largest(
    of_view: Callable[[Splats, Camera], Float[Tensor, " n"]],
    splats: Splats,
    cameras: Collection[Camera],
    on_progress: OnProgress,
    at_least: Float[Tensor, " n"] | None = None,
    enough: float = torch.inf,
) -> Float[Tensor, " n"]:
    """The largest number that any view has for each Gaussian, of those >= 0.
    at_least, enough: see `largest_contributions`."""
    largest = splats.means.new_zeros(len(splats)) if at_least is None else at_least.clone()
    for number, camera in enumerate(cameras, start=1):
        torch.maximum(largest, of_view(splats, camera), out=largest)
        if enough < torch.inf and (largest > enough).all():
            on_progress(len(cameras), len(cameras))
            break
        on_progress(number, len(cameras))
    return largest


def shares_of_picture(
    splats: Splats, camera: Camera, rasterizer: Rasterizer, *parts: Bool[Tensor, "h w"]
) -> Float[Tensor, "k n"]:
    """The share of the whole picture that each Gaussian makes up:
    of all its pixels, and of those in each of up to two `parts`; in [0, 1].

    A picture is linear in the colours. So the gradient of a channel's sum over some pixels by a Gaussian's colour is
    the Gaussian's weight in these pixels; each of the three channels sums over other pixels.
    """
    white = splats.detached().marked(slice(None))
    white.sh.requires_grad_()
    asked = white.means.new_zeros(camera.height, camera.width, 3)
    asked[..., 0] = 1
    for channel, part in enumerate(parts, start=1):
        asked[..., channel] = part
    with torch.enable_grad():
        picture = rasterizer.render(white, camera)
    (sums,) = torch.autograd.grad(picture, white.sh, asked)
    return sums[:, 0, : 1 + len(parts)].T / (SH_0 * camera.height * camera.width)
