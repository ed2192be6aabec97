"""The sky of a look, also where no training photo looked.

A disc of the dome learns its colour from the photos that show it. All others keep their initial grey, to which the SH
transfer adds something arbitrary: somebody who turns round in a viewer would see brown clouds. Therefore every disc
takes its colour from those that photos show.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from core.data.collection import spread_over
from core.rasterizer import Rasterizer
from core.scene.camera import Camera
from core.scene.harmonics import SH_0, basis, evaluated
from core.scene.splats import Splats
from core.system.threads import one_torch_thread

# Between two directions whose colours correlate by 1 / e; this and NOISE were chosen in core/TRIED.md, "The sky".
LENGTH_DEGREES = 80.0
NOISE = 1.0  # variance of the colour of a disc that one photo shows unobstructed, over that of the sky
# How many training cameras are used, and the longer side of their pictures: a disc is 5 degrees wide.
VIEWS, SIDE_PX = 128, 100
# Discs from which others take their colour: all of the usual dome's; the cost grows with the cube of their number.
MOST = 2000


@dataclass(frozen=True)
class SmoothSky:
    """Ordinary kriging on the sphere (Cressie, Statistics for Spatial Data, 3.2): the best linear unbiased estimate of
    a sky whose mean is unknown and whose covariance is exp(-angle / LENGTH_DEGREES), from discs with a noise of
    variance NOISE / k, k being the sum of a disc's largest contributions to the training views: nearly the number of
    photos that show it.

    shown: rows of the dome that photos show, MOST of them at most. weights: of their colours in each disc's, a row adds
    up to 1. basis: of the SH, towards those shown. The dome is so far away that every disc has one colour from wherever
    it is seen.
    """

    shown: Int[Tensor, " o"]
    weights: Float[Tensor, "s o"]
    basis: Float[Tensor, "o c"]

    @staticmethod
    @torch.no_grad()
    def of(splats: Splats, sky_count: int, cameras: Sequence[Camera], rasterizer: Rasterizer) -> "SmoothSky | None":
        """That of Gaussians whose last `sky_count` are the dome, as these cameras show it; None if they show none."""
        if not sky_count:
            return None
        photos = torch.zeros(sky_count, dtype=torch.float64, device=splats.means.device)
        for camera in spread_over(cameras, VIEWS):
            small = camera.within(SIDE_PX)
            photos += rasterizer.contributions(splats, small)[-sky_count:]
        shown = photos.nonzero()[:, 0]
        if not len(shown):
            return None
        every = -(-len(shown) // MOST)
        # Discs lie in rings from pole to pole, so these are spread over all that is shown; each stands for `every`.
        shown = shown[::every]
        with one_torch_thread():  # more would round differently
            directions = F.normalize(splats.means[-sky_count:].double(), dim=1)
            # In place: 320 MB for the largest dome.
            angles = (directions @ directions[shown].T).clamp_(-1, 1).arccos_().rad2deg_()
            covariance = angles.div_(-LENGTH_DEGREES).exp_()
            inverse = torch.linalg.inv(covariance[shown] + torch.diag(NOISE / (every * photos[shown])))
            simple = covariance @ inverse
            mean = inverse.sum(dim=0) / inverse.sum()
            weights = simple.add_((1 - simple.sum(dim=1, keepdim=True)) * mean)
        return SmoothSky(shown, weights.float(), basis(directions[shown].float(), splats.degree))

    def of_discs(self, discs: Int[Tensor, " d"]) -> "SmoothSky":
        """The same for these discs alone, which take their colours from as many others."""
        return replace(self, weights=self.weights[discs])

    def sh(self, sh: Float[Tensor, "o c 3"]) -> Float[Tensor, "s c 3"]:
        """The coefficients of all discs from those of the discs that photos show."""
        with one_torch_thread():
            # Less 0.5, as a row of weights adds up to 1. By channel, product and gradient take a quarter of the time.
            channels = F.linear(evaluated(self.basis, sh).T.contiguous(), self.weights)
        return torch.cat([(channels.T / SH_0)[:, None], sh.new_zeros(len(self.weights), sh.shape[1] - 1, 3)], dim=1)

    def over(self, baked: Splats) -> Splats:
        """The Gaussians of a look under this sky."""
        place, dome = baked.sh.split((len(baked) - len(self.weights), len(self.weights)))
        return baked.with_sh(torch.cat([place, self.sh(dome[self.shown])]))
