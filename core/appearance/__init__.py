"""How looks differ: photo -> embedding and mask (encoder), embedding -> colours of the Gaussians (transfer)."""

from core.appearance.encoder import shrink
from core.appearance.model import AppearanceModel, Look

__all__ = ["AppearanceModel", "Look", "shrink"]
