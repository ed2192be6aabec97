"""The masks of a run as pictures, for the user to look at."""

from pathlib import Path

import cv2
import numpy as np
import torch

from core.appearance.model import AppearanceModel
from core.data.collection import png_paths
from core.export.pictures import write_png
from core.training.pictures import Pictures


def write_masks(folder: Path, model: AppearanceModel, pictures: Pictures) -> int:
    """FOLDER/masks/NAME.png for every photo, at its training size: white is static, black is hidden. Returns how many."""
    paths = png_paths(picture.photo.name for picture in pictures)
    written = 0
    for index in range(len(pictures)):
        picture = pictures[index]
        with torch.no_grad():
            mask = model.look(picture.encoder_input, index).mask
        if mask is None:
            break
        target = folder / "masks" / paths[picture.photo.name]
        target.parent.mkdir(parents=True, exist_ok=True)
        values = (mask[0].cpu().numpy() * 255).round().astype(np.uint8)
        write_png(target, cv2.resize(values, (picture.camera.width, picture.camera.height)))
        written += 1
    return written
