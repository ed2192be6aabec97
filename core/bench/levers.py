"""What a rasterizer can trade for time, measured with the functions of the definition (core.rasterizer.reference).

The contract fixes the thresholds, so no backend takes them as arguments. Here the definition is blended tile by tile
with other thresholds.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from core.rasterizer import contract, reference
from core.scene.camera import Camera
from core.scene.harmonics import MAX_DEGREE, colour
from core.scene.splats import Splats


@dataclass(frozen=True)
class Levers:
    """alpha_min, stop_transmittance: see the contract.
    tile_px: side of the tiles that get a list of splats of their own."""

    dtype: torch.dtype = torch.float64
    alpha_min: float = contract.ALPHA_MIN
    stop_transmittance: float = contract.STOP_TRANSMITTANCE
    tile_px: int = 16
    sh_degree: int = MAX_DEGREE


# As good as no thresholds: only contributions below a thousandth of half an 8-bit step are left out.
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
