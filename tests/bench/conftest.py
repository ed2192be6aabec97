"""A finished run of seconds, for the figures that need one."""

import pytest

from core.looks.trained import load_run
from tests.small import finished, small_collection, small_settings

CHECKS = 4


@pytest.fixture(scope="session")
def small_run(tmp_path_factory):
    """The folder of a run with CHECKS looks at its held-out photos."""
    photos, folder = tmp_path_factory.mktemp("photos"), tmp_path_factory.mktemp("runs") / "small"
    return finished(small_collection(photos), small_settings(held_out_checks=CHECKS), folder).folder


@pytest.fixture
def trained(small_run):
    return load_run(small_run)
