"""What several tests of other programs' formats begin with."""

import pytest

from tests.data.converted import write_nerfstudio
from tests.data.small_scene import SmallScene


@pytest.fixture
def scene(tmp_path):
    """A transforms.json of four photos with points; `load_collection(root)` reads it."""
    return write_nerfstudio(SmallScene().write(tmp_path / "colmap"), tmp_path / "scene")
