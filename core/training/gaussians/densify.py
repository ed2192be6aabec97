"""Density control under a hard cap (3DGS section 5.2, with a budget beside its threshold)."""

import math

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from core.config import Settings
from core.kernels.compiled import exact_kernel
from core.scene.quaternions import rotations
from core.training.gaussians.gaussians import Gaussians

SPLIT_SCALE = 0.01  # scene units (3DGS: percent_dense): larger Gaussians split, smaller ones are cloned
SPLIT_SHRINK = 1.6  # 3DGS
LEAST_KEPT = 1 / 4  # of the Gaussians, whatever they contribute: after few steps none are opaque yet
GRADIENT_THRESHOLD = 2e-4  # 3DGS threshold on the mean gradient of the projected centre, in half pictures
# Longest axis over the shortest, at most. From near, viewers that form a c - b^2 in float32 draw what is stiffer than
# 400 wrong. Photos look the same: in them no splat is less than half a pixel wide.
STIFFEST = 300.0
ALL_GONE = (
    "The last Gaussians were removed as faint, large, far from the points or of no use; only the sky is left, if any. "
    "Look at the scene with `wegs doctor`, and at the settings prune_opacity, largest_scale and reach."
)


def gather(gaussians: Gaussians, rows: Tensor, probe_gradient: Tensor, half_size: Tensor, taken: Tensor) -> None:
    """Add one view's screen-space gradients to the statistics, if its step is `taken` ().

    rows: (V,) int64; on a GPU, -1 is padding. probe_gradient: (V, 2) dL/d(projected centre) per pixel, which is scaled
    to half pictures so that picture size does not matter. half_size: (2,), half the picture's width and height, px.
    """
    if rows.device.type == "cuda":
        # Triton, which a machine without a GPU need not have.
        from core.training.gaussians import density_statistics_cuda

        density_statistics_cuda.gather(gaussians, rows, probe_gradient, half_size, taken)
    elif taken:
        _gather(
            *(tensor.numpy() for tensor in (probe_gradient, half_size, rows, gaussians.gradient_sum, gaussians.seen))
        )


@exact_kernel
def _gather(gradients, half_size, rows, gradient_sum, seen):
    for i in range(len(rows)):
        x, y = gradients[i, 0] * half_size[0], gradients[i, 1] * half_size[1]
        gradient_sum[rows[i]] += np.sqrt(x * x + y * y)
        seen[rows[i]] += np.float32(1)


def plain_gather(gaussians: Gaussians, rows: Tensor, probe_gradient: Tensor, half_size: Tensor, taken: Tensor) -> None:
    """The definition of `gather`, on any device."""
    size = (probe_gradient * half_size).norm(dim=1)
    gaussians.gradient_sum.index_add_(0, rows, torch.where(taken, size, 0))
    gaussians.seen.index_add_(0, rows, taken.float().expand(len(rows)))


class Surroundings:
    """Where Gaussians may be: near the SfM points, as near as these lie to each other.

    What floats elsewhere explains one photo and spoils the view of the others. Each point allows a ball around it, with
    a radius of `reach` times its distance to its fourth neighbour, or times the median of these distances if that is
    larger.
    """

    def __init__(self, points: np.ndarray, reach: float):
        self.tree = cKDTree(points)
        distances = self.tree.query(points, k=[min(5, len(points))])[0][:, 0]
        # Where most points coincide, the median of the others; where all do, Gaussians may be anywhere.
        apart = distances[distances > 0]
        usual = np.median(distances) or (np.median(apart) if len(apart) else np.inf)
        self.radii = reach * np.clip(distances, usual, None)

    def outside(self, means: Tensor) -> Tensor:
        """Which of the centres (N, 3) lie in no ball around one of their eight nearest points."""
        # The tree refuses NaN; a Gaussian that is not finite is removed in any case, wherever it is taken to be.
        distances, nearest = self.tree.query(
            torch.nan_to_num(means).cpu().numpy(), k=range(1, min(8, len(self.radii)) + 1)
        )
        return torch.from_numpy((distances > self.radii[nearest]).all(axis=1)).to(means.device)


def prune(gaussians: Gaussians, settings: Settings, surroundings: Surroundings | None = None) -> None:
    """Remove what is too faint, too large, too far from all SfM points or not finite."""
    splats = gaussians.splats
    bad = torch.sigmoid(splats.logit_opacities) < settings.prune_opacity
    bad |= splats.log_scales.amax(dim=1) > torch.tensor(settings.largest_scale).log()
    if surroundings is not None:
        bad |= surroundings.outside(splats.means)
    bad |= ~splats.finite_rows()
    gaussians.keep(~bad)


def thicken(gaussians: Gaussians) -> None:
    """Widen axes that are shorter than 1 / STIFFEST of their Gaussian's longest axis to that length."""
    log_scales = gaussians.parameters["log_scales"][: gaussians.solid_count]
    log_scales.copy_(torch.maximum(log_scales, log_scales.amax(dim=1, keepdim=True) - math.log(STIFFEST)))


def prune_by_contribution(gaussians: Gaussians, largest: Tensor, share: float) -> None:
    """Remove Gaussians whose largest contribution to any view (N,) is below `share`,
    but keep at least LEAST_KEPT of all, the strongest."""
    solid = gaussians.solid_count
    least = solid - int((1 - LEAST_KEPT) * solid)
    kept = largest >= share
    # By rank: most may reach nothing, and then a quarter of them is still a quarter.
    kept[torch.sort(largest[:solid], descending=True, stable=True).indices[:least]] = True
    gaussians.keep(kept)


def grow(gaussians: Gaussians, budget: int, generator: torch.Generator) -> None:
    """Clone or split the Gaussians with screen-space gradients above GRADIENT_THRESHOLD,
    but at most `budget` of them, those with the largest.

    A cloned Gaussian keeps its place and gains a twin; a split one is replaced by two smaller ones drawn from it.
    The gathered statistics start anew.
    """
    solid = gaussians.solid_count
    gradient = gaussians.gradient_sum / gaussians.seen.clamp_min(1)
    gradient[solid:] = 0
    count = min(budget, int((gradient > GRADIENT_THRESHOLD).sum()))
    if count > 0:
        _multiply(gaussians, gradient, count, generator)
    gaussians.gradient_sum.zero_()
    gaussians.seen.zero_()


def _multiply(gaussians: Gaussians, gradient: Tensor, count: int, generator: torch.Generator) -> None:
    """Clone or split the `count` Gaussians with the largest gradients (N,)."""
    # A stable order makes ties, and with them whole runs, reproducible.
    chosen = torch.sort(gradient, descending=True, stable=True).indices[:count].sort().values
    born = {name: tensor[chosen].clone() for name, tensor in gaussians.parameters.items()}
    large = born["log_scales"].amax(dim=1) > torch.tensor(SPLIT_SCALE).log()
    split, centres = chosen[large], born["means"][large]
    spread, turn = torch.exp(born["log_scales"][large]), rotations(born["quaternions"][large])

    def drawn() -> Tensor:
        offset = torch.randn(spread.shape, generator=generator).to(spread) * spread
        return centres + torch.einsum("nij,nj->ni", turn, offset)

    moved, born["means"][large] = drawn(), drawn()
    born["log_scales"][large] -= torch.tensor(SPLIT_SHRINK).log()
    smaller = born["log_scales"][large]
    gaussians.insert(born)  # where memory runs out here, the Gaussians that are saved are still as they were
    gaussians.parameters["means"][split], gaussians.parameters["log_scales"][split] = moved, smaller
