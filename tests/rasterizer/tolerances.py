"""How far a backend in float32 may be from the reference in float64, and why."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor

from core.rasterizer import Rasterizer
from core.rasterizer.contract import ALPHA_MAX, ALPHA_MIN, STOP_TRANSMITTANCE
from core.rasterizer.reference import ReferenceRasterizer, coverage, pixel_chunks, projected
from tests.rasterizer.scenes import Scene

EXACT = 1e-12  # float64 against the same formula in another order of operations, values of order 1

# Colours are of order 1. A projected centre is rounded to about 1e-7 of the picture's size plus the
# principal point's distance (100 px: 1e-5 px), and alpha changes by at most 1 a pixel. The reference itself in float32
# is within 6e-6 in all scenes.
PICTURE = 1e-5

# Of a tensor's largest gradient. Gradients are sums of terms with both signs over all pixels of a splat: the reference
# in float32 is within 2e-5.
GRADIENT = 5e-5
GRADIENT_ON_GPU = 6e-5  # in a picture of one pixel, where nothing averages out
# Of a Gaussian's own gradient plus FAINT of the largest in the tensor, so that mistakes in faint or far ones show too.
# A backward pass that runs front to back subtracts from a running sum: deep in a stack, where 1e-4 of light remains,
# the rounding of what stands in front (1e-7) is 1e-3 of a gradient.
GRADIENT_OF_ONE = 1e-2
FAINT = 1e-3

# At a threshold one splat may be drawn or not: then it changes alpha by 1/255 at the faint end, and at the stopping end
# the pixel by what was left, alpha T <= ALPHA_MAX * STOP / (1 - ALPHA_MAX) = 0.0099. Colours reach 2.5 in these scenes.
FLIPPED_PIXEL = 2.5 * ALPHA_MAX * STOP_TRANSMITTANCE / (1 - ALPHA_MAX)
# Pixels that close to a threshold are rare, or the scene would test nothing.
FLIPPED_SHARE = 0.05

# A splat that is drawn must be visible. A visible one may miss all pixels, but only while the box of its ellipse is
# within this distance of the picture: 1e-2 px is far above rounding and far below a pixel.
FOOTPRINT_PX = 1e-2


@dataclass
class Outcome:
    """All that a backend says about a scene; `gradients` by parameter name, "probe" included."""

    image: Tensor
    gradients: dict[str, Tensor]
    visible: Tensor
    contributions: Tensor


def outcome(backend: Rasterizer, scene: Scene, dtype: torch.dtype, cotangent: Tensor) -> Outcome:
    """Run everything; the gradients are those of sum(image * cotangent)."""
    splats = scene.splats.map(lambda tensor: tensor.to(dtype, copy=True).requires_grad_())
    probe = torch.zeros(len(splats), 2, dtype=dtype, requires_grad=True)
    image = backend.render(splats, scene.camera, scene.background, probe)
    inputs = splats.tensors() | {"probe": probe}
    gradients = torch.autograd.grad((image * cotangent.to(dtype)).sum(), list(inputs.values()))
    splats = splats.detached()
    return Outcome(
        image.detach(),
        dict(zip(inputs, gradients)),
        backend.visible(splats, scene.camera).rows,
        backend.contributions(splats, scene.camera),
    )


@dataclass
class Verdict:
    """A scene, the reference's outcome in float64, the pixels that no rounding flips, and the cotangent used."""

    scene: Scene
    outcome: Outcome
    steady: Tensor
    cotangent: Tensor


@cache
def verdict(make: Callable[[], Scene]) -> Verdict:
    """The judge's view of a scene of SCENES. Pixels at a threshold get no weight in the gradients."""
    scene = make()
    steady = steady_pixels(scene)
    random = torch.Generator().manual_seed(7)
    cotangent = torch.randn(*steady.shape, 3, generator=random) * steady[:, :, None]
    return Verdict(scene, outcome(ReferenceRasterizer(), scene, torch.float64, cotangent), steady, cotangent)


def steady_pixels(scene: Scene) -> Tensor:
    """(height, width) bool: the pixels where no splat is within the scene's margin of a threshold, in float64."""
    camera, splats = scene.camera, scene.splats.map(torch.Tensor.double)
    rows, seen = projected(splats, camera)
    raw = torch.cat(
        [
            coverage(pixels, seen.centres, seen.conics, seen.opacities)
            for pixels in pixel_chunks(camera, len(rows), seen.centres)
        ]
    )
    alphas = torch.where(raw < ALPHA_MIN, 0, raw).clamp_max(ALPHA_MAX)
    behind = torch.cumprod(1 - alphas, dim=1)
    before = torch.cat([torch.ones_like(behind[:, :1]), behind[:, :-1]], dim=1)
    reached = before >= STOP_TRANSMITTANCE
    close = torch.zeros_like(reached)
    for value, threshold in ((raw, ALPHA_MIN), (raw, ALPHA_MAX), (behind, STOP_TRANSMITTANCE)):
        close |= (value / threshold - 1).abs() < scene.margin
    return ~(close & reached).any(dim=1).reshape(camera.height, camera.width)
