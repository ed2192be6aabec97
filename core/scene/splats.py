"""Splats: the Gaussians of one look, which is all that rasterizers, exporters and viewers ever see."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from core.scene.frame import SceneFrame
from core.scene.harmonics import coefficient_count, dc_of_colour, degree_of

QUATERNION_MIN_NORM2 = 1e-12  # below: no rotation, so nothing to draw


@dataclass
class Splats:
    """N Gaussians, parametrised as in a 3DGS .ply.

    means: scene units. quaternions: w x y z, any norm > 1e-6. log_scales: natural log of the standard deviations, scene
    units. logit_opacities: before the sigmoid. sh: coefficients (C = 1, 4, 9 or 16 per channel), DC first.
    """

    means: Float[Tensor, "n 3"]
    quaternions: Float[Tensor, "n 4"]
    log_scales: Float[Tensor, "n 3"]
    logit_opacities: Float[Tensor, " n"]
    sh: Float[Tensor, "n c 3"]

    def __len__(self) -> int:
        return self.means.shape[0]

    @property
    def degree(self) -> int:
        return degree_of(self.sh.shape[1])

    def tensors(self) -> dict[str, Tensor]:
        """The parameters by name, in the order of the fields."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def map(self, function: Callable[[Tensor], Tensor]) -> "Splats":
        """`function` applied to every tensor."""
        return Splats(**{name: function(tensor) for name, tensor in self.tensors().items()})

    def __getitem__(self, rows) -> "Splats":
        """The Gaussians selected by an index tensor, mask or slice."""
        return self.map(lambda tensor: tensor[rows])

    def finite_rows(self) -> Bool[Tensor, " n"]:
        """The Gaussians without NaN and Inf."""
        rows = [torch.isfinite(tensor[..., None]).flatten(1).all(dim=1) for tensor in self.tensors().values()]
        return torch.stack(rows).all(dim=0)

    def up_to_degree(self, degree: int) -> "Splats":
        """The same Gaussians without the SH bands above `degree`."""
        return self.with_sh(self.sh[:, : coefficient_count(degree)].contiguous())

    def with_sh(self, sh: Float[Tensor, "n c 3"]) -> "Splats":
        """The same Gaussians in another look."""
        return replace(self, sh=sh)

    def marked(self, rows) -> "Splats":
        """The same Gaussians, white in `rows` (an index tensor, mask or slice) and black elsewhere: a picture of them
        over black is what these rows weigh in each pixel."""
        colours = torch.zeros_like(self.sh[:, :1])
        colours[rows] = 1
        return self.with_sh(dc_of_colour(colours))

    def detached(self) -> "Splats":
        return self.map(torch.Tensor.detach)

    @staticmethod
    def concatenate(parts: "list[Splats]") -> "Splats":
        """The Gaussians of all parts, in order. All parts share one SH degree."""
        return Splats(*map(torch.cat, zip(*(part.tensors().values() for part in parts), strict=True)))

    def in_world(self, frame: SceneFrame) -> "Splats":
        """The Gaussians in world units; the sum is formed in float64 and returned in this dtype."""
        return self._moved(frame.to_world, np.log(frame.radius))

    def in_scene(self, frame: SceneFrame) -> "Splats":
        """The inverse of `in_world`."""
        return self._moved(frame.to_scene, -np.log(frame.radius))

    def _moved(self, move: Callable[[np.ndarray], np.ndarray], log_growth: float) -> "Splats":
        means = torch.from_numpy(move(self.means.detach().double().cpu().numpy()))
        return replace(self, means=means.to(self.means), log_scales=self.log_scales + float(log_growth))
