"""How the README's pictures are written."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from core.report import Report
from core.system.atomic import write_bytes

QUALITY = 88


def write_jpeg(path: Path, pixels: UInt8[np.ndarray, "h w 3"], report: Report) -> None:
    """Write an RGB picture, and say where it is and how large."""
    write_bytes(path, cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes())
    report.say(f"{path}: {pixels.shape[1]}x{pixels.shape[0]} px")
