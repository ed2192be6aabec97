"""Renders against photos: metrics, protocols, result files and picture sheets."""
