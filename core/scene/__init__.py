"""Cameras, Gaussians and the frame they live in: what every other part of the engine speaks about."""
