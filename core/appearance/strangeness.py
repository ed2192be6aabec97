"""How strange a photo's places look: transients, such as passers-by,
bring colours that the place does not have in any light."""

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

# The yardstick of an error, in chromaticity: what differs by less is light, or what is not learned yet. On training
# photos of plaza 79 % of the passers-by differ by more and 27 % of the rest, on those of the Statue of Liberty 14 % of
# everything.
STRANGE = 0.05
# Quantile of a photo's errors that is its yardstick if above STRANGE: passers-by seldom cover more than the rest.
USUAL = 0.8
LARGEST_EXCESS = 2.0  # an error three times the yardstick is as strange as can be
DARK = 0.1  # brightness at which a chromaticity counts half: in the dark it is noise
BRIGHTEST = 2.0  # of a render or a photo in training, far above what exposure jitter brings
RIDGE = 1e-4  # of colours in [0, 1] squared: where they vary by less than a hundredth they say nothing about a tone


def excess(shown: Float[Tensor, "3 h w"], wanted: Float[Tensor, "3 h w"]) -> Float[Tensor, "1 h w"]:
    """By how much a photo differs from a render beyond the yardstick, in units of it: from 0 to LARGEST_EXCESS.

    shown, wanted: render and photo, averaged over cells. The render is brought into the photo's tone, and what is left
    between their chromaticities is the error: a passer-by changes it, shade and detail that is not learned yet hardly
    do. The yardstick is STRANGE, or the photo's own large errors if these are larger. Where the photo is black (or says
    nothing, as under a given mask) there is no error.
    """
    shown, wanted = shown.clamp(0, BRIGHTEST), wanted.clamp(0, BRIGHTEST)
    tints = chromaticity(torch.stack([retoned(shown, wanted), wanted]))
    error = (tints[0] - tints[1]).abs().mean(dim=0, keepdim=True)
    error = smoothed(torch.where(wanted.amax(dim=0, keepdim=True) > 0, error, 0))
    return (error / quantile(error, USUAL).clamp_min(STRANGE) - 1).clamp(0, LARGEST_EXCESS)


def chromaticity(colours: Float[Tensor, "2 3 h w"]) -> Float[Tensor, "2 3 h w"]:
    """Colours over their own brightness, so that shade does not show; dark ones fade."""
    return colours / (colours.mean(dim=1, keepdim=True) + DARK)


def retoned(shown: Float[Tensor, "3 h w"], wanted: Float[Tensor, "3 h w"]) -> Float[Tensor, "3 h w"]:
    """`shown` in the tone of `wanted`, by the affine map of colours that suits the cells best (least squares); >= 0.

    So a tone that the look has not learned does not make a photo strange. Where the colours do not determine a map, it
    stays near the identity. (Robust weights, which keep passers-by from bending the map, found no more of them.)
    """
    inputs = torch.cat([shown, torch.ones_like(shown[:1])]).flatten(1)
    share = inputs / inputs.shape[1]
    gram = share @ inputs.T
    gram.diagonal().add_(RIDGE)
    change = torch.linalg.solve_ex(gram, share @ (wanted - shown).flatten(1).T).result  # which does not wait for a GPU
    return (shown + (change.T @ inputs).view_as(shown)).clamp_min(0)


def smoothed(cells: Float[Tensor, "1 h w"]) -> Float[Tensor, "1 h w"]:
    """Averaged with the eight cells around, those at the rim repeated: people cover more than one."""
    return F.avg_pool2d(F.pad(cells[None], (1, 1, 1, 1), mode="replicate"), 3, stride=1)[0]


def quantile(values: Float[Tensor, "..."], share: float) -> Float[Tensor, ""]:
    """torch.quantile of finite values, in three kernels of a GPU instead of twenty."""
    ascending = values.flatten().sort().values
    rank = np.float32(share) * np.float32(len(ascending) - 1)
    below = int(rank)
    return torch.lerp(ascending[below], ascending[min(below + 1, len(ascending) - 1)], float(rank - np.float32(below)))
