"""The wegs engine: photo collections in, 3D Gaussians with a changeable look out."""

__version__ = "0.1.0"
