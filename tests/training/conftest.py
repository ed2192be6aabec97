"""What several tests of training begin with."""

import pytest

from core.training.trainer import Trainer
from tests.small import small_collection, small_settings


@pytest.fixture
def trainer_of(tmp_path):
    """Trainers of the small collection, with what is to differ from its settings."""
    collection = small_collection(tmp_path)
    return lambda **changes: Trainer(collection, small_settings(**changes), tmp_path)
