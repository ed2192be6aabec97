"""The definition of the picture: 3D Gaussian splatting in plain torch, one function per stage.

Read it from top to bottom: cull, project, colour, sort, blend. Nothing is approximated beyond what the contract states
and every gradient is autograd's, so the fast backends are judged by this one in float64. It looks at every splat in
every pixel: use it for small pictures only.

Source: Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering" (2023), sections 4 and 6, and
Zwicker et al., "EWA Volume Splatting" (2001), for the projection.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from core.rasterizer.contract import (
    ALPHA_MAX,
    ALPHA_MIN,
    BLACK,
    BLUR_PX2,
    LOG_SCALE_RANGE,
    NEAR,
    STOP_TRANSMITTANCE,
    Colour,
    Rasterizer,
    Visible,
    jacobian_limits,
)
from core.rasterizer.shares import Shares
from core.scene.camera import Camera
from core.scene.cells import cell_of_pixels, grid
from core.scene.harmonics import colour
from core.scene.quaternions import rotations
from core.scene.splats import QUATERNION_MIN_NORM2, Splats

CHUNK = 1 << 20  # pairs of a pixel and a splat that are blended at once; bounds the memory (some 20 numbers per pair)


@dataclass
class Projection:
    """N Gaussians as 2D ones in the picture.

    centres: px. conics: the entries (xx, xy, yy) of the inverse 2D covariances, px^-2. variances: the diagonal of the
    2D covariances, px^2. directions: unit vectors from the camera to the means. opacities: in [0, 1].
    """

    centres: Float[Tensor, "n 2"]
    conics: Float[Tensor, "n 3"]
    variances: Float[Tensor, "n 2"]
    directions: Float[Tensor, "n 3"]
    opacities: Float[Tensor, " n"]


class ReferenceRasterizer(Rasterizer):
    """The contract's definition; any floating dtype, any device. See `contract.Rasterizer` for the methods.

    One difference from the contract: torch's own sums may differ in the last bit between numbers of threads.
    """

    name, device = "reference", "any"

    def visible(self, splats: Splats, camera: Camera) -> Visible:
        return Visible(visible_rows(splats, camera))

    def render(
        self,
        splats: Splats,
        camera: Camera,
        background: Colour = BLACK,
        probe: Float[Tensor, "n 2"] | None = None,
        known: None = None,
    ) -> Float[Tensor, "h w 3"]:
        rows, projection = projected(splats, camera)
        colours = colour(splats.sh[rows], projection.directions)
        centres = projection.centres if probe is None else projection.centres + probe[rows]

        backdrop = colours.new_tensor(background)
        pictures = []
        for pixels in pixel_chunks(camera, len(rows), centres):
            # A checkpoint keeps only the inputs and blends again in the backward pass: memory for one chunk at a time.
            picture = checkpoint(
                blend, pixels, centres, projection.conics, projection.opacities, colours, backdrop, use_reentrant=False
            )
            pictures.append(picture)
        return torch.cat(pictures).reshape(camera.height, camera.width, 3)

    @torch.no_grad()
    def contributions(self, splats: Splats, camera: Camera, known: None = None) -> Float[Tensor, " n"]:
        rows, projection = projected(splats, camera)
        largest = projection.opacities.new_zeros(len(rows))
        for pixels in pixel_chunks(camera, len(rows), projection.centres):
            weights, _ = blend_weights(pixels, projection.centres, projection.conics, projection.opacities)
            largest = torch.maximum(largest, weights.amax(dim=0))
        return splats.logit_opacities.new_zeros(len(splats)).index_put((rows,), largest)

    @torch.no_grad()
    def shares(self, splats: Splats, camera: Camera, weight: Float[Tensor, "h w"]) -> Shares:
        rows, projection = projected(splats, camera)
        shape = math.prod(grid(*weight.shape)), len(splats)
        shares = projection.opacities.new_zeros(shape)
        chunks = pixel_chunks(camera, len(rows), projection.centres)
        pixel_weights, pixel_cells = (each.flatten().split(len(chunks[0])) for each in (weight, cell_of_pixels(weight)))
        for pixels, of_pixels, cells in zip(chunks, pixel_weights, pixel_cells):
            weights, _ = blend_weights(pixels, projection.centres, projection.conics, projection.opacities)
            shares.index_put_((cells[:, None], rows), of_pixels[:, None] * weights, accumulate=True)
        cells, gaussians = shares.nonzero(as_tuple=True)
        return Shares(cells, gaussians, shares[cells, gaussians], shape)


# ---------------------------------------------------------------------------------------------------------------- cull


@torch.no_grad()
def visible_rows(splats: Splats, camera: Camera) -> Int[Tensor, " v"]:
    """The rows of the Gaussians that are not culled, ascending."""
    candidates = torch.nonzero(can_be_projected(splats, camera)).squeeze(1)
    projection = project(splats[candidates], camera)
    keep = touches_picture(projection, camera)
    # Finite coefficients may add up beyond the dtype.
    keep &= torch.isfinite(colour(splats.sh[candidates], projection.directions)).all(dim=1)
    return candidates[keep]


def projected(splats: Splats, camera: Camera) -> tuple[Int[Tensor, " v"], Projection]:
    """The rows of the visible Gaussians, front to back, and what the camera sees of these.

    Selected before any differentiable arithmetic: a NaN that enters it would come back out of the gradient of a mere
    mask, because 0 * NaN = NaN.
    """
    rows = visible_rows(splats, camera)
    rows = rows[front_to_back(splats[rows], camera)]
    return rows, project(splats[rows], camera)


def can_be_projected(splats: Splats, camera: Camera) -> Bool[Tensor, " n"]:
    """Which Gaussians are finite, in front of the camera, have a quaternion that is a rotation,
    and are not too faint to show anywhere."""
    keep = splats.finite_rows()
    offsets = offsets_from(camera, splats.means)
    _, _, depths = in_camera_axes(camera, offsets)
    norms2 = splats.quaternions.square().sum(dim=1)
    # Written so that NaN fails them, and so do finite inputs whose squares overflow.
    keep &= depths > NEAR
    keep &= torch.isfinite(offsets.square().sum(dim=1))
    keep &= (norms2 >= QUATERNION_MIN_NORM2) & torch.isfinite(norms2)
    keep &= torch.sigmoid(splats.logit_opacities) >= ALPHA_MIN
    return keep


def touches_picture(projection: Projection, camera: Camera) -> Bool[Tensor, " n"]:
    """Whether the ellipse opacity * exp(-d' S^-1 d / 2) >= ALPHA_MIN is one,
    and the box around it meets the picture."""
    low, high = boxes(projection, ALPHA_MIN)
    inside = (high >= 0) & (low <= low.new_tensor([camera.width, camera.height]))
    return inside.all(dim=1) & is_ellipse(projection)


def boxes(projection: Projection, alpha_min: float) -> tuple[Float[Tensor, "n 2"], Float[Tensor, "n 2"]]:
    """Least and largest x and y (px) of the ellipses opacity * exp(-d' S^-1 d / 2) >= alpha_min."""
    extents = (2 * torch.log(projection.opacities / alpha_min).clamp_min(0)[:, None] * projection.variances).sqrt()
    return projection.centres - extents, projection.centres + extents


def is_ellipse(projection: Projection) -> Bool[Tensor, " n"]:
    """Whether the conics can be computed with. A determinant beyond the dtype leaves those of 0,
    whose gradient is not finite."""
    return (projection.conics[:, [0, 2]] > 0).all(dim=1) & torch.isfinite(projection.conics).all(dim=1)


# ------------------------------------------------------------------------------------------------------------- project


def project(splats: Splats, camera: Camera) -> Projection:
    """The Gaussians as the camera sees them (3DGS equation 5; every row must pass `can_be_projected`).

    The 2D covariance is J W S W' J' + blur, where S = R D D R' is the covariance in space (3DGS equation 6), W the
    rotation of the camera and J the Jacobian of the perspective division at the mean. With the 2x3 factor V = J W R D
    that is V V' + blur.
    """
    offsets = offsets_from(camera, splats.means)
    x, y, depths = in_camera_axes(camera, offsets)
    centres = torch.stack([camera.fx * x / depths + camera.cx, camera.fy * y / depths + camera.cy], dim=1)

    scales = splats.log_scales.clamp(*LOG_SCALE_RANGE).exp()
    rotation = offsets.new_tensor(camera.world_to_camera)
    factor = jacobians(camera, x / depths, y / depths, depths) @ rotation @ rotations(splats.quaternions)
    v_x, v_y = (factor * scales[:, None, :]).unbind(dim=1)
    xx, xy, yy = (v_x * v_x).sum(dim=1), (v_x * v_y).sum(dim=1), (v_y * v_y).sum(dim=1)
    variances = torch.stack([xx, yy], dim=1) + BLUR_PX2
    # det(V V' + e I) from the factor: a difference of products, xx * yy - xy^2, is nothing but rounding for a needle.
    determinants = torch.linalg.cross(v_x, v_y).square().sum(dim=1) + BLUR_PX2 * (xx + yy) + BLUR_PX2**2
    conics = torch.stack([variances[:, 1], -xy, variances[:, 0]], dim=1) / determinants[:, None]

    directions = offsets / offsets.square().sum(dim=1, keepdim=True).sqrt()
    return Projection(centres, conics, variances, directions, torch.sigmoid(splats.logit_opacities))


def offsets_from(camera: Camera, means: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """The way from the camera's centre to each of the means, along the world's axes; scene units.

    Subtracted before anything is rotated: far from the origin float32 needs that.
    """
    return means - means.new_tensor(camera.centre)


def in_camera_axes(
    camera: Camera, offsets: Float[Tensor, "n 3"]
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"], Float[Tensor, " n"]]:
    """The offsets along the camera's axes: x right, y down, z (the depth) forward; scene units."""
    x, y, z = offsets.unbind(dim=1)
    # Term by term: a matrix product may round each row in its own way, and equal depths have to stay equal.
    right, down, forward = [row[0] * x + row[1] * y + row[2] * z for row in camera.world_to_camera.tolist()]
    return right, down, forward


def jacobians(
    camera: Camera, x_slopes: Float[Tensor, " n"], y_slopes: Float[Tensor, " n"], depths: Float[Tensor, " n"]
) -> Float[Tensor, "n 2 3"]:
    """d(pixel) / d(camera axes) at slopes x / z and y / z, which are clamped to the neighbourhood of the picture.

    Without the clamp a wide Gaussian beside the picture has a footprint out of all proportion; it is the original's,
    made to follow the principal point.
    """
    left, right, top, bottom = jacobian_limits(camera)
    x_slopes, y_slopes = x_slopes.clamp(left, right), y_slopes.clamp(top, bottom)
    zero = torch.zeros_like(depths)
    row_x = torch.stack([camera.fx / depths, zero, -camera.fx * x_slopes / depths], dim=1)
    row_y = torch.stack([zero, camera.fy / depths, -camera.fy * y_slopes / depths], dim=1)
    return torch.stack([row_x, row_y], dim=1)


# ---------------------------------------------------------------------------------------------------------------- sort


def front_to_back(splats: Splats, camera: Camera) -> Int[Tensor, " n"]:
    """The order of blending: by depth; the stable sort breaks ties by index."""
    _, _, depths = in_camera_axes(camera, offsets_from(camera, splats.means.detach()))
    return torch.sort(depths, stable=True).indices


# --------------------------------------------------------------------------------------------------------------- blend


def pixel_chunks(camera: Camera, splat_count: int, like: Tensor) -> tuple[Float[Tensor, "p 2"], ...]:
    """The centres (px) of all pixels, row by row, CHUNK pixel-splat pairs at a time; dtype and device of `like`."""
    x = torch.arange(camera.width, dtype=like.dtype, device=like.device) + 0.5
    y = torch.arange(camera.height, dtype=like.dtype, device=like.device) + 0.5
    rows, columns = torch.meshgrid(y, x, indexing="ij")
    return torch.stack([columns.flatten(), rows.flatten()], dim=1).split(max(1, CHUNK // max(1, splat_count)))


def blend(
    pixels: Float[Tensor, "p 2"],
    centres: Float[Tensor, "n 2"],
    conics: Float[Tensor, "n 3"],
    opacities: Float[Tensor, " n"],
    colours: Float[Tensor, "n 3"],
    background: Float[Tensor, " 3"],
) -> Float[Tensor, "p 3"]:
    """The colours of the pixels. The splats come front to back."""
    weights, transmittances = blend_weights(pixels, centres, conics, opacities)
    return weights @ colours + transmittances[:, None] * background


def blend_weights(
    pixels: Float[Tensor, "p 2"],
    centres: Float[Tensor, "n 2"],
    conics: Float[Tensor, "n 3"],
    opacities: Float[Tensor, " n"],
    alpha_min: float = ALPHA_MIN,
    stop_transmittance: float = STOP_TRANSMITTANCE,
) -> tuple[Float[Tensor, "p n"], Float[Tensor, " p"]]:
    """How much of each splat shows in each pixel, and how much of the background (3DGS equations 3 and 4).

    Each splat covers alpha = opacity * exp(-d' S^-1 d / 2) of what is behind it, so its weight is alpha times the
    transmittance in front of it, the product of 1 - alpha over all splats before. The thresholds are the contract's,
    except where core.bench measures what they cost.
    """
    alphas = coverage(pixels, centres, conics, opacities)
    alphas = torch.where(alphas < alpha_min, 0, alphas).clamp_max(ALPHA_MAX)
    with torch.no_grad():
        unfinished = torch.cumprod(1 - alphas, dim=1) >= stop_transmittance
    # Everything from the stopping splat on is absent, the stopping splat included.
    alphas = torch.where(unfinished, alphas, 0)
    left_over = torch.cumprod(1 - alphas, dim=1)
    before = torch.cat([torch.ones_like(pixels[:, :1]), left_over], dim=1)
    return alphas * before[:, :-1], before[:, -1]


def coverage(
    pixels: Float[Tensor, "p 2"],
    centres: Float[Tensor, "n 2"],
    conics: Float[Tensor, "n 3"],
    opacities: Float[Tensor, " n"],
) -> Float[Tensor, "p n"]:
    """opacity * exp(-d' S^-1 d / 2) of each splat at each pixel, before any threshold."""
    x, y = (pixels[:, None, :] - centres[None, :, :]).unbind(dim=2)
    xx, xy, yy = conics.unbind(dim=1)
    power = -0.5 * (xx * x * x + yy * y * y) - xy * x * y
    # Never positive but for rounding: a million pixels from a needle's centre float32 would say e^1000.
    return opacities * torch.exp(power.clamp_max(0))
