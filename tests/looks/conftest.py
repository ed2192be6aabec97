import pytest

from core.looks.trained import TrainedRun
from tests.looks.lit_corner import lit_corner


@pytest.fixture(scope="session")
def trained(tmp_path_factory) -> TrainedRun:
    """The room corner; photo 0 is held out. Files that need less have a smaller run of this name."""
    return lit_corner(tmp_path_factory.mktemp("corner"), steps=300)
