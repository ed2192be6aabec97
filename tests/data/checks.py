"""What tests of readers ask of a collection."""

import numpy as np


def texts_of(notes):
    return [note.text for note in notes]


def notes_with(collection, text):
    return [line for line in texts_of(collection.notes) if text in line]


def check_geometry(collection, scene, scale=1.0):
    """Every photo's camera projects the points where the model saw them (pinhole models); float64: 1e-6 px."""
    assert [photo.name for photo in collection.photos] == sorted(scene.names)
    for photo in collection.photos:
        pixels, depth = photo.camera.project(collection.points)
        assert np.abs(pixels - scene.seen(scene.names.index(photo.name)) * scale).max() < 1e-6
        assert (depth > 0).all()
        assert (photo.points == np.arange(len(scene.points))).all()
