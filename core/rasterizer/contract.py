"""What a rasterizer must do. Every backend shares these constants, these tie-breaks and these signatures."""

from dataclasses import dataclass
from math import log, log2
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Float, Int
from torch import Tensor

from core.rasterizer.shares import Shares
from core.scene.camera import Camera
from core.scene.splats import Splats

# The constants of the original 3DGS viewer, so that a baked file looks there as it looks here.
ALPHA_MIN = 1.0 / 255.0  # a weaker contribution to a pixel is skipped
LOG2_ALPHA_MIN = log2(ALPHA_MIN)
LEAST_LOGIT = log(ALPHA_MIN / (1.0 - ALPHA_MIN))  # of an opacity: a fainter Gaussian shows nowhere
# Keeps 1 / (1 - alpha) tame; the gradient is zero where alpha is clamped. The float32 number next to 0.99, in every
# precision: two clamped splats leave (1 - ALPHA_MAX)^2, which only then lies on the same side of STOP_TRANSMITTANCE for
# all backends.
ALPHA_MAX = 0.9900000095367432
STOP_TRANSMITTANCE = 1e-4  # a pixel is finished when the next splat would bring it below this
BLUR_PX2 = 0.3  # added to the diagonal of every 2D covariance (EWA low-pass), px^2

NEAR = 0.01  # scene units; nearer centres are culled before any division
JACOBIAN_MARGIN = 0.15  # x/z and y/z are clamped to the picture's box widened by this share on each side, for J only
LOG_SCALE_RANGE = (-20.0, 10.0)  # scene units; clamped before exp, zero gradient outside

Colour = tuple[float, float, float]  # red, green, blue in [0, 1]
BLACK: Colour = (0.0, 0.0, 0.0)


def jacobian_limits(camera: Camera) -> tuple[float, float, float, float]:
    """Least and largest x / z, least and largest y / z, to which slopes are clamped in the Jacobian:
    the picture's box widened by JACOBIAN_MARGIN.
    """
    margin_x, margin_y = JACOBIAN_MARGIN * camera.width, JACOBIAN_MARGIN * camera.height
    return (
        float((-margin_x - camera.cx) / camera.fx),
        float((camera.width + margin_x - camera.cx) / camera.fx),
        float((-margin_y - camera.cy) / camera.fy),
        float((camera.height + margin_y - camera.cy) / camera.fy),
    )


@dataclass(frozen=True)
class Visible:
    """What a camera shows. rows: ascending indices of the Gaussians that are not culled
    (a tight superset of those drawn).

    known: what the backend has computed about them, in a form of its own, for calls of `render` with exactly these
    Gaussians (in any look) and this view. On a CPU their tile lists; on a GPU the view and an upper bound on the number
    of pairs of a Gaussian and a tile, for which the host would otherwise have to wait. The reference keeps nothing.
    """

    rows: Int[Tensor, " v"]
    known: Any = None


@runtime_checkable
class Rasterizer(Protocol):
    """A backend. Stateless for the caller; pictures and gradients do not depend on the number of threads.

    Order: front to back by camera depth, ties by index. Culled (drawn as absent, zero gradient of the right shape): not
    finite in any parameter or in its colour, depth not > NEAR, quaternion norm^2 < QUATERNION_MIN_NORM2,
    opacity < ALPHA_MIN, footprint outside the picture. The footprint is the exact ellipse around the projected centre
    in which opacity * exp(-d' S^-1 d / 2) >= ALPHA_MIN.

    Backends of kernels raise BadInput for tensors of another dtype, device or shape than they take, and
    inputs.ListsTooLarge for a picture whose tile lists do not fit into memory.
    """

    name: str
    device: str  # where it takes tensors: "cpu", "cuda" or "any"

    def visible(self, splats: Splats, camera: Camera) -> Visible:
        """Which Gaussians are not culled in this view."""

    def render(
        self,
        splats: Splats,
        camera: Camera,
        background: Colour = BLACK,
        probe: Float[Tensor, "n 2"] | None = None,
        known: Any = None,
    ) -> Float[Tensor, "h w 3"]:
        """The picture: a linear blend of the splats over the background, not clamped at 1;
        differentiable in every tensor of `splats`.

        probe: zeros that are added to the projected centres (px); its gradient dL/d(centre) drives density control.
        known: what `visible` says of these Gaussians; None if it was not asked. With it, a backend may count on a probe
        of zeros.
        """

    def contributions(self, splats: Splats, camera: Camera, known: Any = None) -> Float[Tensor, " n"]:
        """The largest alpha * transmittance each Gaussian reaches in any pixel, in [0, 1]; not differentiable.
        known: as in `render`."""

    def shares(self, splats: Splats, camera: Camera, weight: Float[Tensor, "h w"]) -> Shares:
        """How much each Gaussian makes up of each cell of the picture (core.scene.cells): the sum of weight * alpha *
        transmittance over its pixels; not differentiable. Times a Gaussian's colour, it is what the Gaussian adds to
        the weighted sum of the cell's pixels, in any look.
        """
