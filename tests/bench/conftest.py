"""A finished run of seconds, for the figures that need one."""

import pytest

from core.looks.trained import load_run
from core.training import run
from core.training.trainer import Trainer
from tests.small import small_collection, small_settings

CHECKS = 4


@pytest.fixture(scope="session")
def small_run(tmp_path_factory):
    """The folder of a run with CHECKS looks at its held-out photos."""
    photos, folder = tmp_path_factory.mktemp("photos"), tmp_path_factory.mktemp("runs") / "small"
    collection, settings = small_collection(photos), small_settings(held_out_checks=CHECKS)
    trainer = Trainer(collection, settings, folder)
    run.create(folder, collection, settings)
    for _ in trainer.train():
        pass
    return folder


@pytest.fixture
def trained(small_run):
    return load_run(small_run)
