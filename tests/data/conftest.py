"""What tests of this folder share."""

import pytest

from tests.data.room_corner import corner_with_points


@pytest.fixture(scope="session")
def corner(tmp_path_factory):
    """The corner and its points; photo 0 is held out."""
    return corner_with_points(tmp_path_factory.mktemp("scene"))
