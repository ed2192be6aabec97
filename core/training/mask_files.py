"""The masks of a run as pictures, for the user to look at."""

from pathlib import Path

import cv2
import numpy as np
import torch

from core.appearance.model import AppearanceModel
from core.data.photos.names import png_paths
from core.export.pictures import write_png
from core.report import QUIET, Report
from core.run.run_folders import MASKS
from core.training.sized_photos import SizedPhotos


def write_masks(folder: Path, model: AppearanceModel, photos: SizedPhotos, report: Report = QUIET) -> int:
    """`masks/NAME.png` in the run folder for every photo that has a mask, at its training size: white is used, black is
    hidden, by the network or by the mask that the user gave. Returns how many."""
    paths = png_paths(sized.photo.name for sized in photos)
    learns_masks = model.settings.has_masks
    masked = [(index, sized) for index, sized in enumerate(photos) if learns_masks or sized.photo.mask]
    for number, (index, sized) in enumerate(masked, 1):
        width, height = sized.camera.width, sized.camera.height
        shown: np.ndarray = np.ones((height, width), np.float32)
        with torch.no_grad():
            mask = model.read(sized.encoder_input, index).mask if learns_masks else None
        if mask is not None:
            shown = cv2.resize(mask[0].cpu().numpy(), (width, height))
        if sized.photo.mask is not None and sized.valid is not None:
            shown = shown * sized.valid
        target = folder / MASKS / paths[sized.photo.name]
        target.parent.mkdir(parents=True, exist_ok=True)
        write_png(target, (shown * 255).round().astype(np.uint8))
        report.progress("Masks", number, len(masked))
    return len(masked)
