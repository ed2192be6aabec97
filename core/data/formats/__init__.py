"""Cameras and points as other programs write them; each format is read into a Posed."""
