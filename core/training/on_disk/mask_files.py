"""The masks of a run as pictures, for the user to look at."""

from pathlib import Path

import cv2
import numpy as np
import torch

from core.appearance.model import AppearanceModel
from core.data.collection import png_paths
from core.export.pictures import write_png
from core.training.sized_photos import SizedPhotos


def write_masks(folder: Path, model: AppearanceModel, photos: SizedPhotos) -> int:
    """FOLDER/masks/NAME.png for every photo, at its training size: white is static, black is hidden. Returns how many."""
    paths = png_paths(sized.photo.name for sized in photos)
    written = 0
    for index in range(len(photos)):
        sized = photos[index]
        with torch.no_grad():
            mask = model.look(sized.encoder_input, index).mask
        if mask is None:
            break
        target = folder / "masks" / paths[sized.photo.name]
        target.parent.mkdir(parents=True, exist_ok=True)
        values = (mask[0].cpu().numpy() * 255).round().astype(np.uint8)
        write_png(target, cv2.resize(values, (sized.camera.width, sized.camera.height)))
        written += 1
    return written
