"""What several tests of training begin with."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from core.scene.frame import SceneFrame
from core.scene.lens import Lens
from core.training.gaussians.gaussians import Gaussians
from core.training.gaussians.initialisation import initial_gaussians
from core.training.trainer import Trainer
from tests.small import small_collection, small_settings

RATES = {  # settings: for whatever learns, a rate that nothing else has
    "mean_rate": 0.1,
    "quaternion_rate": 0.2,
    "scale_rate": 0.3,
    "opacity_rate": 0.4,
    "sh_rate": 0.5,
    "embedding_rate": 0.6,
    "network_rate": 0.7,
    "encoder_rate": 0.8,
}


@pytest.fixture
def trainer_of(tmp_path):
    """Trainers of the small collection, with what is to differ from its settings."""
    collection = small_collection(tmp_path)
    return lambda **changes: Trainer(collection, small_settings(**changes), tmp_path)


@pytest.fixture
def collection(tmp_path):
    """A collection with a frame that is not the world, and a lens."""
    folder = tmp_path / "scene"
    folder.mkdir()
    made = small_collection(folder)
    lens = Lens("SIMPLE_RADIAL", 48, 36, [50.0, 24.0, 18.0, 0.1])
    photos = (replace(made.photos[0], lens=lens), *made.photos[1:])
    return replace(made, photos=photos, frame=SceneFrame(np.array([100.0, -20.0, 1 / 3]), 7.0))


@pytest.fixture
def gaussians(tmp_path) -> Gaussians:
    """Those that a run of the small collection starts with."""
    settings = small_settings()
    return initial_gaussians(small_collection(tmp_path), settings, torch.Generator().manual_seed(1))
