"""What several tests of runs begin with."""

from dataclasses import replace

import numpy as np
import pytest

from core.scene.frame import SceneFrame
from core.scene.lens import Lens
from tests.small import small_collection


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The current folder, which is empty."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def collection(tmp_path):
    """A collection with a frame that is not the world, and a lens."""
    folder = tmp_path / "scene"
    folder.mkdir()
    made = small_collection(folder)
    lens = Lens("SIMPLE_RADIAL", 48, 36, [50.0, 24.0, 18.0, 0.1])
    photos = (replace(made.photos[0], lens=lens), *made.photos[1:])
    return replace(made, photos=photos, frame=SceneFrame(np.array([100.0, -20.0, 1 / 3]), 7.0))
