"""The quality of a run in progress: renders of its held-out photos, in their looks, against the photos."""

from statistics import fmean

import torch

from core.appearance.model import AppearanceModel
from core.evaluation.metrics import psnr
from core.rasterizer import Colour, Rasterizer
from core.run.sized_photo import as_tensors
from core.system.threads import threads_for_blocks
from core.training.gaussians.gaussians import Gaussians
from core.training.losses.photometric import Target, photometric
from core.training.sized_photos import SizedPhotos


@torch.no_grad()
@threads_for_blocks()
def quality(
    photos: SizedPhotos, gaussians: Gaussians, model: AppearanceModel, rasterizer: Rasterizer, background: Colour
) -> tuple[float, float] | tuple[None, None]:
    """Mean PSNR (dB) and SSIM (the loss's) over valid pixels,
    each photo in the look that is read from the whole of it; (None, None) without photos.

    background: what renders are drawn over.
    """
    decibels, similarities = [], []
    for sized in photos:
        reading = model.read(sized.encoder_input)
        splats = model.bake(gaussians.splats, reading.embedding, gaussians.latents)
        image = rasterizer.render(splats, sized.camera, background).clamp(0, 1)
        photo, valid = as_tensors(sized.pixels, sized.valid, image.device)
        decibels.append(psnr(image, photo, valid))
        similarities.append(1 - float(photometric(image, Target(photo, valid), None, 1.0)))
    return (fmean(decibels), fmean(similarities)) if decibels else (None, None)
