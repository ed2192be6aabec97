"""What several tests of training begin with."""

import pytest
import torch

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
def collection(tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    return small_collection(folder)


@pytest.fixture
def trainer_of(tmp_path):
    """Trainers of the small collection, with what is to differ from its settings."""
    collection = small_collection(tmp_path)
    return lambda **changes: Trainer(collection, small_settings(**changes), tmp_path)


@pytest.fixture
def gaussians(tmp_path) -> Gaussians:
    """Those that a run of the small collection starts with."""
    settings = small_settings()
    return initial_gaussians(small_collection(tmp_path), settings, torch.Generator().manual_seed(1))
